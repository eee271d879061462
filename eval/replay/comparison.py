"""Bitwise comparison of a replay with the recording."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.telemetry.signals import Rows
from eval.replay.replayer import Replay, ReplayResult


class Difference(NamedTuple):
    """First tick at which a signal differs from the recording."""

    tick: int
    signal: str
    found: NDArray[np.generic]
    recorded: NDArray[np.generic]


def first_difference(found: Rows, recorded: Rows) -> Difference | None:
    """Return the first tick at which any bit differs; of several signals in that tick, the first in a row's order."""
    first: Difference | None = None
    for name in recorded.dtype.names or ():
        a, b = found[name], recorded[name]
        ticks = np.flatnonzero((_bits(a) != _bits(b)).any(axis=1))
        if ticks.size and (first is None or recorded["tick"][ticks[0]] < first.tick):
            first = Difference(int(recorded["tick"][ticks[0]]), name, a[ticks[0]], b[ticks[0]])
    return first


def mismatch(replay: Replay, result: ReplayResult) -> str:
    """Return the first mismatch in words; empty if everything is equal."""
    info = replay.info
    if difference := first_difference(result.rows, replay.recorded):
        return (
            f"at tick {difference.tick - info.event.start:+d} of the event, {difference.signal}: found"
            f" {difference.found.tolist()}, recorded {difference.recorded.tolist()}"
        )
    if result.event != info.event:
        return f"the judge found {result.event}, recorded {info.event}"
    return "" if result.end_digest == info.end_digest else "all signals agree, but not the state at the end"


def _bits(array: NDArray[np.generic]) -> NDArray[np.uint8]:
    """(T, bytes); NaNs compare by their bits."""
    return np.ascontiguousarray(array).reshape(len(array), -1).view(np.uint8)
