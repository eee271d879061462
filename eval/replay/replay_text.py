"""Replay in words: the ticks around the start of the event, and the first difference from the recording."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.reasons import describe
from deploy.state import Mode
from deploy.telemetry.signals import Rows
from eval.replay.replayer import Replay, ReplayResult

BEFORE, AFTER = 5, 10
"""Ticks shown before an event, and from its start on."""
TOOL_COLUMNS = ("x m", "y m", "z m", "speed m/s")
JOINT_COLUMNS = {
    **{"q sent": "q_sent", "q true": "q_true", "q est.": "q", "qd true": "qd_true"},
    **{"N·m sent": "tau_sent", "N·m true": "tau_true", "winding °C": "winding_true_c"},
}
"""Signals of a row by the titles of their columns."""


def table(replay: Replay, result: ReplayResult) -> Iterator[str]:
    """Yield load (1 at the limit), mode and signals of each tick, bad ticks marked with !, then each stop's reason."""
    event, spec = replay.info.event, replay.spec
    joint = None if event.joint is None else spec.joint_names.index(event.joint)
    names = TOOL_COLUMNS if joint is None else tuple(JOINT_COLUMNS)
    yield _line(" tick", "mode", "load", names, "reasons")
    start = event.start - replay.info.begin
    for place in range(max(0, start - BEFORE), min(len(result.rows), start + AFTER)):
        row, load = result.rows[place], result.load[place]
        joint_values = (row[name][joint] for name in JOINT_COLUMNS.values())
        shown = tuple(f"{x:.4g}" for x in (_tool_values(row) if joint is None else joint_values))
        mark, reason = " " if load <= 1 else "!", int(row["reason"])
        tick, mode = f"{mark}{place - start:+4d}", Mode(int(row["mode"])).name
        yield _line(tick, mode, f"{load:.4g}", shown, describe(reason) if reason else "")
    for place, text in result.stops.items():
        yield f"stop in tick {place - start:+d}: {text}"


def _line(tick: str, mode: str, load: str, numbers: tuple[str, ...], reasons: str) -> str:
    return f"{tick} {mode:<9}{load:>8}{''.join(f'{x:>11}' for x in numbers)}  {reasons}".rstrip()


def _tool_values(row: Rows) -> tuple[float, ...]:
    velocity = row["tool_velocity_true"]
    return (*row["tool_true"].tolist(), float(velocity @ velocity) ** 0.5)


class Mismatch(NamedTuple):
    """First tick at which a signal differs from the recording."""

    tick: int
    signal: str
    found: NDArray[np.generic]
    recorded: NDArray[np.generic]


def first_difference(found: Rows, recorded: Rows) -> Mismatch | None:
    """Return the first tick at which any bit differs; of several signals in that tick, the first in a row's order."""
    first: Mismatch | None = None
    for name in recorded.dtype.names or ():
        a, b = found[name], recorded[name]
        ticks = np.flatnonzero((_bits(a) != _bits(b)).any(axis=1))
        if ticks.size and (first is None or recorded["tick"][ticks[0]] < first.tick):
            first = Mismatch(int(recorded["tick"][ticks[0]]), name, a[ticks[0]], b[ticks[0]])
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
