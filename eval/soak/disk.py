"""How much a soak may write, said before it starts, and whether there is room for it."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from deploy.tasks.task import find_task
from eval.judge.monitors import MONITORS
from eval.replay import bundle
from eval.replay.capture_window import window_type
from eval.replay.event_capture import HARD_KEPT, LOOKS, SOFT_KEPT
from eval.report.series import columns
from eval.soak.configuration import Soak
from eval.soak.shard import LOOK_S, Shard, shard_result
from robots.distributions import load_distributions
from robots.errors import OutputError

MEMBER_BYTES = 512
"""Of an array in an npz beside its numbers: its headers and its name, twice."""
BLOCK_BYTES = 4096
"""By which the size of a file on a disk is rounded up."""
MCAP_NUMBER, MCAP_ROW_BYTES = 2, 1024
"""A recording has less than half of its numbers as text, of up to 25 characters for 8 bytes; and what a tick has of
names, headers and spheres, which repeat and are compressed."""
SERIES_NUMBER_BYTES, SERIES_COLUMN_BYTES = 12, 4096
"""Of a number in series.parquet, which may stand in a dictionary and in its index, and of a column's own."""
REPORT_BYTES = 32 << 20
"""Of report.html, report.json, junit.xml and the trends: curves of so many points, events up to so many."""


class Room(NamedTuple):
    """Bytes on disk, at most; a file that is replaced is there twice for a while.

    Attributes:
        checkpoints: of shards, while they live. events: of their bundles. report: and what lies beside it.
        hourly: what each simulated hour of a robot has of all that: its samples. The rest does not grow with time.
    """

    checkpoints: int
    events: int
    report: int
    hourly: float

    @property
    def total(self) -> int:
        """Bytes."""
        return self.checkpoints + self.events + self.report

    def said(self) -> str:
        """For whoever starts the soak."""
        return (
            f"disk: at most {_mb(self.total)}: {_mb(self.checkpoints)} to go on from, {_mb(self.events)} of events,"
            f" {_mb(self.report)} of report; of these, {_mb(self.hourly)} for each simulated hour of a robot"
        )


def room(soak: Soak) -> Room:
    """What `soak` may write at most, from the sizes of all that a shard keeps."""
    jobs, distributions = soak.jobs(), load_distributions(soak.spec)
    shard = Shard(jobs[0])
    draws = len(shard.robot.draw.to_json(soak.seed, distributions, soak.spec))
    state = shard.snapshot()
    shard.sample()
    saved = shard.save()
    told = columns(soak, shard_result(soak.spec, soak.policy.contract, jobs[0].robots, saved), 0)
    samples = soak.ticks // soak.sample_ticks + 1
    sample = sum(array.nbytes for name, array in saved.items() if name not in state)
    row = SERIES_NUMBER_BYTES * len(told)
    most = sum(HARD_KEPT if monitor.hard else SOFT_KEPT for monitor in MONITORS)
    # A file is beside the one that it takes the place of, at most one of each worker at a time.
    shards = len(jobs) + min(soak.workers, len(jobs))
    events = len(jobs) * most + min(soak.workers, len(jobs))
    return Room(
        checkpoints=shards * (_npz(saved) + samples * sample + BLOCK_BYTES),
        events=events * (_npz(state) + _window(soak) + draws + _copied(soak)),
        report=REPORT_BYTES
        + len(jobs) * draws
        + len(told) * SERIES_COLUMN_BYTES
        + samples * soak.robots * row,
        hourly=samples / soak.hours * (shards * sample / soak.robots + row),
    )


def check_room(soak: Soak, out: Path, kept: Path, console: Console) -> None:
    """Say what the soak may write into the folder `out`, which is there.

    Args:
        soak: what was asked for. out: where.
        kept: a folder in it; what an earlier start left there is replaced, or counted already.
        console: told.

    Raises:
        OutputError: there is no room for it.
    """
    needed = room(soak)
    console.print(needed.said(), soft_wrap=True, highlight=False)
    there, free = _size(kept), shutil.disk_usage(out).free
    if needed.total > free + there:
        raise OutputError(
            f"--out {out}: found {_mb(free)} free, expected {_mb(needed.total - there)}, which is the most that the"
            " soak may write"
        )


def _npz(arrays: Mapping[str, NDArray[np.generic]]) -> int:
    """Of arrays that do not compress, deflated or not."""
    return sum(MEMBER_BYTES + array.nbytes + array.nbytes // 1000 for array in arrays.values())


def _window(soak: Soak) -> int:
    """Of the longest window of an event, as numpy's arrays and as a recording."""
    row = window_type(soak.spec, find_task(soak.policy.contract.task, "contract: task").size)
    ticks = round((LOOKS + 1) * LOOK_S / soak.spec.dt)
    arrays = row.itemsize * ticks + MEMBER_BYTES * len(row.names or ())
    return arrays + ticks * (MCAP_NUMBER * row.itemsize + MCAP_ROW_BYTES)


def _copied(soak: Soak) -> int:
    """Of the files that a bundle copies, and of its description."""
    robot = [soak.spec.folder / name for name in bundle.robot_files(soak.spec)]
    files = [soak.policy_path, *robot]
    blocks = (len(bundle.FILES) + len(robot) + 1) * BLOCK_BYTES
    return sum(file.stat().st_size for file in files) + bundle.ABOUT_CHARACTERS_MAX + blocks


def _size(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def _mb(size: float) -> str:
    return f"{size / 1e6:.1f} MB"
