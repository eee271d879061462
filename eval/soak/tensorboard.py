"""TensorBoard event file of a soak: rates, work and heat over time, all robots together."""

import io
from collections.abc import Iterator, Sequence
from datetime import datetime
from itertools import pairwise

import numpy as np
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from eval.judge.monitors import MONITORS
from eval.shard.judging import ShardResult
from eval.soak.assembly import pad_and_join, running_total
from eval.soak.configuration import SoakConfig
from robots.arrays import Floats, Ints

TENSORBOARD = "tensorboard/events.out.tfevents.soak"
"""Always the same name, so that a later soak replaces an earlier one instead of being plotted over it."""
VERSION = "brain.Event:2"
POINTS = 64
HARD = np.array([monitor.hard for monitor in MONITORS])


def event_file(config: SoakConfig, shards: Sequence[ShardResult], started: str) -> bytes:
    """Return the event file. Steps are simulated seconds; wall time is `started`, ISO 8601, plus simulated time."""
    start, stream = datetime.fromisoformat(started).timestamp(), io.BytesIO()
    writer = RecordWriter(stream)
    for event in (Event(wall_time=start, file_version=VERSION), *_points(config, shards, start)):
        writer.write(event.SerializeToString())
    return stream.getvalue()


def _points(config: SoakConfig, shards: Sequence[ShardResult], start: float) -> Iterator[Event]:
    """One event for each interval, at its end, with the rates and shares of that interval."""
    sample_s = config.sample_ticks * config.spec.dt
    totals = {name: running_total([getattr(shard, name) for shard in shards]) for name in _TOTALS}
    samples = [np.arange(len(shard.running))[:, None] * np.ones_like(shard.running) for shard in shards]
    ticks = config.sample_ticks * running_total(samples)
    hot, folded = (pad_and_join([getattr(s, name) for s in shards]) for name in ("winding_c", "folded_back"))
    edges = intervals(len(ticks) - 1, sample_s)
    per_s = round(1 / config.spec.dt)
    for a, b in pairwise(edges):
        increase = {name: total[b] - total[a] for name, total in totals.items()}
        work = _work(increase, ticks[b] - ticks[a], increase["running"] * config.spec.dt / 3600)
        values = work | _heat(hot[a + 1 : b + 1], folded[a + 1 : b + 1])
        known = [Summary.Value(tag=tag, simple_value=float(x)) for tag, x in values.items() if np.isfinite(x)]
        step = b * config.sample_ticks // per_s
        yield Event(wall_time=start + b * sample_s, step=step, summary=Summary(value=known))


_TOTALS = ("attempted", "reached", "running", "stops", "events")


def intervals(samples: int, sample_s: float) -> list[int]:
    """Return the samples that separate intervals: at most `POINTS` intervals, none shorter than a step."""
    width = max(1, -(-samples // POINTS), int(np.ceil(1 / sample_s)))
    return [*range(0, max(1, samples - width + 1), width), samples] if samples else [0]


def _work(increase: dict[str, Ints], ticks: Ints, hours: float) -> dict[str, float]:
    """Rates per hour of operating time of one robot; NaN without operating time, or without goals."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = increase["events"] / np.float64(hours)
        by_monitor = {
            f"violations_per_hour_{'hard' if m.hard else 'soft'}/{m.name}": r
            for m, r in zip(MONITORS, rate, strict=True)
        }
        return {
            **by_monitor,
            "violations_per_hour_hard/all": rate[HARD].sum(),
            "violations_per_hour_soft/all": rate[~HARD].sum(),
            "work/availability": increase["running"] / ticks,
            "work/goals_reached_share": increase["reached"] / increase["attempted"],
            "work/stops_per_hour": increase["stops"] / np.float64(hours),
        }


def _heat(winding_c: Floats, folded_back: Floats) -> dict[str, float]:
    """Maximum and mean of (T, R, n); NaN where nothing is known."""
    return {
        "heat/hottest_winding_c": np.fmax.reduce(winding_c, axis=None),
        "heat/folded_back_most": np.fmax.reduce(folded_back, axis=None),
        "heat/folded_back_mean": np.ma.filled(np.ma.masked_invalid(folded_back).mean(), np.nan),
    }
