"""Campaign: mutated files for each reader in turn, for a bounded time, with what its workers found."""

import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from eval.fuzz.target import Target
from eval.fuzz.worker import ACCEPTED, CASE_S, REFUSED

WORK = "import sys; from eval.fuzz.worker import work; work(*sys.argv[1:])"


@dataclass(slots=True)
class Findings:
    """Outcome of the cases of one target.

    Attributes:
        counts: cases by outcome, accepted or refused. slowest: s.
        failures: what was wrong, by number of the case; its files are kept.
    """

    counts: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    failures: dict[int, str] = field(default_factory=dict)

    @property
    def cases(self) -> int:
        """Number of cases that were read."""
        return self.counts.total() + len(self.failures)


def run_campaign(
    table: str, name: str, target: Target, folder: Path, *, seed: int, seconds: float
) -> Findings:
    """Read mutations of a target's example for `seconds`; a worker that dies is replaced by another.

    Args:
        table: name of the table of targets, as in `find_targets`. folder: for the example and the files that failed.
    """
    found, example = Findings(), folder / "examples" / name
    example.mkdir(parents=True)
    target.make(example)
    target.read(example)
    end, number = time.monotonic() + seconds, 0
    while (left := round(end - time.monotonic())) > 0:
        options = (table, name, example, folder, seed, number, left)
        command = [sys.executable, "-c", WORK, *map(str, options)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as worker:
            lines = [line.strip() for line in worker.stdout or ()]
        number = 1 + _count(lines, worker.returncode, found)
    return found


def _count(lines: list[str], code: int, found: Findings) -> int:
    """Count what a worker printed; return the number of its last case.

    Raises:
        RuntimeError: it ended without a case.
    """
    if not lines:
        raise RuntimeError(f"a worker ended with exit code {code} before its first case")
    number = 0
    for line in lines:
        spent, _, outcome = line.partition(" ")
        if not outcome:
            number = int(spent)
            continue
        found.slowest = max(found.slowest, float(spent))
        if outcome in (ACCEPTED, REFUSED):
            found.counts[outcome] += 1
        else:
            found.failures[number] = outcome
    if code:
        found.failures[number] = f"exit code {code}: a crash, or more than {CASE_S} s"
    return number
