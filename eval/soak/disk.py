"""Disk space of a soak: an upper bound computed before it starts, and the check that it is free."""

import os
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
from eval.replay.event_capture import HARD_BUNDLES, SOFT_BUNDLES, WINDOW_POLLS
from eval.shard.job import POLL_S
from eval.shard.judging import shard_result
from eval.shard.shard import Shard
from eval.soak.configuration import SoakConfig
from eval.soak.series import columns
from robots.errors import OutputError

MEMBER_BYTES = 512
"""Overhead of an array in an npz file: its headers, and its name twice."""
BLOCK_BYTES = 4096
"""File sizes on disk are rounded up to a multiple of this."""
MCAP_NUMBER, MCAP_ROW_BYTES = 2, 1024
"""MCAP size factor of numbers: fewer than half of them are text, of up to 25 characters for 8 bytes. Overhead of a
tick: names, headers and spheres, which repeat and are compressed."""
SERIES_NUMBER_BYTES, SERIES_COLUMN_BYTES = 12, 4096
"""Size of a number in series.parquet, which may be in a dictionary and in its index, and overhead of a column."""
REPORT_BYTES = 32 << 20
"""Upper bound of report.html, report.json, junit.xml and TensorBoard's file, whose curves and events are limited."""


class DiskUsage(NamedTuple):
    """Upper bounds in bytes; a file that is replaced exists twice for a while.

    Attributes:
        checkpoints: of shards, while they run. events: bundles. report: reports, draws and series.
        hourly: the part of the total that grows with each simulated hour of a robot: its samples.
    """

    checkpoints: int
    events: int
    report: int
    hourly: float

    @property
    def total(self) -> int:
        """Bytes."""
        return self.checkpoints + self.events + self.report

    def describe(self) -> str:
        """Return a sentence for the console."""
        return (
            f"disk: at most {_mb(self.total)}: {_mb(self.checkpoints)} of checkpoints, {_mb(self.events)} of events,"
            f" {_mb(self.report)} of report; of these, {_mb(self.hourly)} for each simulated hour of a robot"
        )


def disk_usage(config: SoakConfig) -> DiskUsage:
    """Return the most that a soak may write, from the sizes of the arrays of a shard."""
    jobs = config.jobs()
    shard = Shard(jobs[0])
    draws = len(config.draws_json(shard.robot.draw))
    state = shard.snapshot()
    shard.sample()
    saved = shard.save()
    table = columns(config, shard_result(config.spec, config.policy.contract, jobs[0].robots, saved), 0)
    samples = config.ticks // config.sample_ticks + 1
    sample = sum(array.nbytes for name, array in saved.items() if name not in state)
    row = SERIES_NUMBER_BYTES * len(table)
    bundles = sum(HARD_BUNDLES if monitor.hard else SOFT_BUNDLES for monitor in MONITORS)
    # While a file is replaced, old and new exist together: one file of each worker at a time.
    shards = len(jobs) + min(config.workers, len(jobs))
    events = len(jobs) * bundles + min(config.workers, len(jobs))
    return DiskUsage(
        checkpoints=shards * (_npz_bytes(saved) + samples * sample + BLOCK_BYTES),
        events=events * (_npz_bytes(state) + window_bytes(config) + draws + _copy_bytes(config)),
        report=REPORT_BYTES
        + len(jobs) * draws
        + len(table) * SERIES_COLUMN_BYTES
        + samples * config.robots * row,
        hourly=samples / config.hours * (shards * sample / config.robots + row),
    )


def check_disk_space(config: SoakConfig, out: Path, unfinished: Path, console: Console) -> None:
    """Print how much the soak may write into the folder `out`, which must exist, and check that it is free.

    Files of an earlier start, in its folder `unfinished`, are replaced or are part of the total.

    Raises:
        OutputError: there is not enough space.
    """
    needed = disk_usage(config)
    console.print(needed.describe(), soft_wrap=True, highlight=False)
    present, free = _folder_bytes(unfinished), shutil.disk_usage(out).free
    if needed.total > free + present:
        raise OutputError(
            f"--out {out}: found {_mb(free)} free, expected {_mb(needed.total - present)}, which is the most that the"
            " soak may write"
        )


def _npz_bytes(arrays: Mapping[str, NDArray[np.generic]]) -> int:
    """Size of arrays that cannot be compressed, deflated or not."""
    return sum(MEMBER_BYTES + array.nbytes + array.nbytes // 1000 for array in arrays.values())


def window_bytes(config: SoakConfig) -> int:
    """Return the size of the longest event window, as npz and MCAP."""
    row = window_type(config.spec, find_task(config.policy.contract.task, "contract: task").size)
    ticks = round((WINDOW_POLLS + 1) * POLL_S / config.spec.dt)
    arrays = row.itemsize * ticks + MEMBER_BYTES * len(row.names or ())
    return arrays + ticks * (MCAP_NUMBER * row.itemsize + MCAP_ROW_BYTES)


def _copy_bytes(config: SoakConfig) -> int:
    """Size of the files that a bundle copies, and of its description."""
    robot = [config.spec.folder / name for name in bundle.robot_files(config.spec)]
    files = [config.policy_path, *robot]
    blocks = (len(bundle.FILES) + len(robot) + 1) * BLOCK_BYTES
    return sum(file.stat().st_size for file in files) + bundle.INFO_CHARACTERS_MAX + blocks


def _folder_bytes(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if os.path.isfile(file))


def _mb(size: float) -> str:
    return f"{size / 1e6:.1f} MB"
