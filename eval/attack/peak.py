"""Bundle of a candidate: the seconds around the tick in which a monitor's ratio was highest, for soak-replay."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from eval.attack.arena import Setting, make_shard, write_job
from eval.attack.candidate import Candidate
from eval.attack.falls import OF_FALLS, Falls
from eval.judge.counts import Event
from eval.replay.bundle import POLICY, bundle_name
from eval.replay.event_capture import EventCapture
from eval.shard.job import POLL_S, WIDTH
from eval.shard.judging import judge_tick, make_judge
from eval.shard.shard import Shard
from robots.spec import load_robot


class Bundle(NamedTuple):
    """Name of a bundle, and the ratio of its monitor at the peak."""

    name: str
    ratio: float


def write_peak(setting: Setting, monitor: str, candidate: Candidate, folder: Path) -> Bundle:
    """Let all robots run a candidate's policy from its file, and write the bundle of a monitor's peak.

    Raises:
        OutputError: the folder cannot be written.
    """
    spec = load_robot(setting.robot)
    poll, ticks = round(POLL_S / spec.dt), setting.ticks(spec)
    with TemporaryDirectory() as place:
        job = write_job(setting, spec, candidate, Path(place) / POLICY)
        shard = make_shard(setting, job, candidate)
        start = shard.snapshot()
        peak = find_peak(shard, monitor, ticks)
        shard.restore(start)
        _run(shard, max(0, peak.start - poll))
        capture = EventCapture(job, shard, folder)
        _run(shard, min(peak.start + poll, ticks))
        capture.write_peak(shard, peak)
    return Bundle(bundle_name(peak.robot, peak.start, monitor), peak.worst)


def find_peak(shard: Shard, monitor: str, ticks: int) -> Event:
    """Run a shard for some ticks; return the first one in which the ratio of a monitor is highest, as an event."""
    judge = make_judge(shard.runtime.spec, shard.runtime.contract, WIDTH)
    counts = judge.counts()
    columns = counts.columns(monitor)
    (catalogued,) = [each for each in counts.monitors if each.name == monitor]
    first = Event(robot=0, monitor=catalogued, joint=None, start=0, ticks=1, worst=-1.0, limit=1.0)
    falls = Falls(shard.runtime.spec, WIDTH)
    for tick in range(ticks):
        shard.tick()
        judge.worst[:] = 0.0
        judge_tick(judge, shard.truth, shard.runtime, shard.action)
        ratios = judge.counts().worst[:, columns]
        if monitor not in OF_FALLS:
            ratios[falls.fallen] = 0.0
        falls.step(shard.truth, shard.runtime.supervisor.powered)
        robot, column = np.unravel_index(np.argmax(ratios), ratios.shape)
        if ratios[robot, column] > first.worst:
            channel = columns.start + int(column)
            joint, limit = counts.channels.joint(channel), float(counts.limits[channel])
            worst = float(ratios[robot, column])
            first = replace(first, robot=int(robot), joint=joint, start=tick, worst=worst, limit=limit)
    return first


def _run(shard: Shard, end: int) -> None:
    while shard.runtime.ticks < end:
        shard.tick()
