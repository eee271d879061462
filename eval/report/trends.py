"""What TensorBoard shows of a soak: how it went from its first hour to its last, all robots together."""

import io
from collections.abc import Iterator, Sequence
from datetime import datetime
from itertools import pairwise

import numpy as np
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from eval.judge.monitors import MONITORS
from eval.report.assembly import running_total, side_by_side
from eval.soak.configuration import Soak
from eval.soak.shard import ShardResult
from robots.arrays import Floats, Ints

TRENDS = "tensorboard/events.out.tfevents.soak"
"""Always the same name, so that a later soak takes the place of an earlier one instead of being drawn over it."""
VERSION = "brain.Event:2"
POINTS = 64
HARD = np.array([monitor.hard for monitor in MONITORS])


def trends(soak: Soak, shards: Sequence[ShardResult], started: str) -> bytes:
    """The event file.

    Steps are simulated seconds; wall time is as if they had been lived in their own time.

    Args:
        soak: what was asked for. shards: what came of it.
        started: ISO 8601 with zone.
    """
    begun, stream = datetime.fromisoformat(started).timestamp(), io.BytesIO()
    writer = RecordWriter(stream)
    for event in (Event(wall_time=begun, file_version=VERSION), *_points(soak, shards, begun)):
        writer.write(event.SerializeToString())
    return stream.getvalue()


def _points(soak: Soak, shards: Sequence[ShardResult], begun: float) -> Iterator[Event]:
    """One for each stretch of time between samples, at its end: rates and shares are of that stretch."""
    sample_s = soak.sample_ticks * soak.spec.dt
    totals = {name: running_total([getattr(shard, name) for shard in shards]) for name in _TOTALS}
    lived = running_total([_lived(soak, shard) for shard in shards])
    hot, folded = (side_by_side([getattr(s, name) for s in shards]) for name in ("winding_c", "folded_back"))
    edges = stretches(len(lived) - 1, sample_s)
    per_s = round(1 / soak.spec.dt)
    for a, b in pairwise(edges):
        came = {name: total[b] - total[a] for name, total in totals.items()}
        work = _work(came, lived[b] - lived[a], came["running"] * soak.spec.dt / 3600)
        values = work | _heat(hot[a + 1 : b + 1], folded[a + 1 : b + 1])
        known = [Summary.Value(tag=tag, simple_value=float(x)) for tag, x in values.items() if np.isfinite(x)]
        step = b * soak.sample_ticks // per_s
        yield Event(wall_time=begun + b * sample_s, step=step, summary=Summary(value=known))


_TOTALS = ("attempted", "reached", "running", "stops", "events")


def stretches(samples: int, sample_s: float) -> list[int]:
    """Samples at which a stretch begins or ends: at most `POINTS` of them, none shorter than a step."""
    each = max(1, -(-samples // POINTS), int(np.ceil(1 / sample_s)))
    return [*range(0, max(1, samples - each + 1), each), samples] if samples else [0]


def _lived(soak: Soak, shard: ShardResult) -> Ints:
    """(T, R) ticks so far."""
    return soak.sample_ticks * np.arange(len(shard.running))[:, None] * np.ones_like(shard.running)


def _work(came: dict[str, Ints], ticks: Ints, hours: float) -> dict[str, float]:
    """Rates are per hour under way, of one robot; NaN for what was not under way, or not due."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = came["events"] / np.float64(hours)
        named = {
            f"violations_per_hour_{'hard' if m.hard else 'soft'}/{m.name}": r
            for m, r in zip(MONITORS, rate, strict=True)
        }
        return {
            **named,
            "violations_per_hour_hard/all": rate[HARD].sum(),
            "violations_per_hour_soft/all": rate[~HARD].sum(),
            "work/availability": came["running"] / ticks,
            "work/goals_reached_share": came["reached"] / came["attempted"],
            "work/stops_per_hour": came["stops"] / np.float64(hours),
        }


def _heat(winding_c: Floats, folded_back: Floats) -> dict[str, float]:
    """Of (T, R, n); NaN where nothing is known."""
    return {
        "heat/hottest_winding_c": np.fmax.reduce(winding_c, axis=None),
        "heat/folded_back_most": np.fmax.reduce(folded_back, axis=None),
        "heat/folded_back_mean": np.ma.filled(np.ma.masked_invalid(folded_back).mean(), np.nan),
    }
