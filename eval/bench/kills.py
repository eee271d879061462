"""Kills: `kill -9` of soak-test, of a worker and of all at random moments; then the same results, and nothing left.

The moments are drawn with a fixed seed, from the first second of a process to the time that a whole soak takes. A soak
that lost its parent is started again in the same folder; one that lost a worker goes on. What a finished soak leaves is
compared with what one that nobody disturbed has left.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from eval.bench.soak_setup import SEED
from eval.shard.job import WIDTH
from robots.spec import RobotSpec

KILLS, ROBOTS, WORKERS = 30, 2 * WIDTH, 2
HOURS = 320 / 3600
"""Simulated hours of each robot: some of them after a checkpoint."""
FIRST_S, GONE_S, POLL_S = 1.0, 30.0, 0.1
"""s from the start of a process to its earliest kill; s after which no other process may be left; s between looks."""
SCRIPT = "from eval.soak.cli import cli; cli()"
WITH_TIMES = ("report.html", "junit.xml", "tensorboard/")
"""Files of a soak that name its start or its wall time."""


class SoakProcess:
    """soak-test in a process group of its own, into the folder "soak" of `place`."""

    def __init__(self, spec: RobotSpec, policy: Path, hours: float, place: Path) -> None:
        """Start it, or go on with what is left of it."""
        place.mkdir(exist_ok=True)
        numbers = {"hours": hours, "robots": ROBOTS, "seed": SEED, "workers": WORKERS}
        options = {"policy": policy.resolve(), "robot": spec.folder, **numbers, "out": "soak"}
        words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
        self.place = place
        self.process = subprocess.Popen(
            [sys.executable, "-c", SCRIPT, *words],
            cwd=place,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )

    def ends_within(self, seconds: float | None) -> bool:
        """Wait for its end, and return whether it came."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)
        return self.process.returncode is not None

    def others(self, program: str = "") -> list[int]:
        """Return the processes that it has started, of those whose command contains `program`."""
        command = ["ps", "-A", "-ww", "-o", "pid=,pgid=,stat=,args="]
        table = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        rows = (line.split(maxsplit=3) for line in table.splitlines())
        group = [row for row in rows if row[1] == str(self.process.pid) and not row[2].startswith("Z")]
        return [int(row[0]) for row in group if row[0] != row[1] and program in row[-1]]

    def left_behind(self) -> list[int]:
        """Return its processes that are still there some time after its end."""
        last = time.monotonic() + GONE_S
        while (left := self.others()) and time.monotonic() < last:
            time.sleep(POLL_S)
        return left

    def results(self) -> dict[str, object]:
        """Return the contents of its files by name, without times, and its exit code."""
        out = self.place / "soak"
        files = {path.relative_to(out).as_posix(): path for path in out.rglob("*") if os.path.isfile(path)}
        report = json.loads(files.pop("report.json").read_text(encoding="utf-8"))
        plain = {name: path.read_bytes() for name, path in files.items() if not name.startswith(WITH_TIMES)}
        return plain | report | {"run": None, "exit code": self.process.returncode}


def _kill_parent(soak: SoakProcess, _: np.random.Generator) -> None:
    soak.process.kill()
    soak.process.wait()


def _kill_worker(soak: SoakProcess, rng: np.random.Generator) -> None:
    """Kill one of its workers, or wait for them."""
    while not (workers := soak.others("spawn_main")) and not soak.ends_within(POLL_S):
        pass
    if workers:
        with suppress(ProcessLookupError):
            os.kill(int(rng.choice(workers)), signal.SIGKILL)


def _kill_all(soak: SoakProcess, _: np.random.Generator) -> None:
    os.killpg(soak.process.pid, signal.SIGKILL)
    soak.process.wait()


KINDS: tuple[Callable[[SoakProcess, np.random.Generator], None], ...] = (
    _kill_parent,
    _kill_worker,
    _kill_all,
)
"""In turns."""


class Trial:
    """Soaks that are killed again and again until they have finished.

    Attributes:
        whole_s: s that a soak takes. kills, soaks: so far. unequal: names of results that differ from those of a whole
            soak. left: processes that outlived their parent.
    """

    def __init__(self, whole_s: float, expected: dict[str, object]) -> None:
        self.whole_s, self._expected, self._rng = whole_s, expected, np.random.default_rng(SEED)
        self.kills, self.soaks, self.unequal, self.left = 0, 0, set[str](), list[int]()

    def run(self, start: Callable[[], SoakProcess], number: int) -> None:
        """Run one soak to its end, with no more kills than `number` in all."""
        soak = start()
        while not soak.ends_within(self._moment() if self.kills < number else None):
            KINDS[self.kills % len(KINDS)](soak, self._rng)
            self.kills += 1
            if soak.ends_within(0):
                self.left += soak.left_behind()
                soak = start()
        self.left += soak.left_behind()
        self.soaks += 1
        found, expected = soak.results(), self._expected
        self.unequal |= {name for name in {*expected, *found} if expected.get(name) != found.get(name)}

    def _moment(self) -> float:
        return float(self._rng.uniform(FIRST_S, self.whole_s))


def kills(spec: RobotSpec, policy: Path, console: Console, hours: float = HOURS, number: int = KILLS) -> None:
    """Disturb soaks by a number of kills; print the results that differ, and the processes that were left."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.monotonic()
        undisturbed = SoakProcess(spec, policy, hours, Path(folder, "undisturbed"))
        undisturbed.ends_within(None)
        trial = Trial(time.monotonic() - began, undisturbed.results())
        while trial.kills < number:
            place = Path(folder, str(trial.soaks))
            trial.run(partial(SoakProcess, spec, policy, hours, place), number)
    found = f"other {', '.join(sorted(trial.unequal))}" if trial.unequal else "the same results"
    console.print(
        f"{trial.kills} kills in {trial.soaks} soaks of {trial.whole_s:.0f} s: {found};"
        f" processes left running: {len(trial.left)}"
    )
