"""Recorded signals: columns of the ring buffer, of event files and of the topic /state, each declared once."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from deploy.runtime import Runtime
from robots.arrays import Bools, Floats
from robots.capabilities import Capability
from robots.spec import RobotSpec

RING_S = 2.0

Rows = NDArray[np.void]

COUNTERS: dict[str, Callable[[Runtime], int | NDArray[np.integer]]] = {
    "tick": lambda runtime: runtime.ticks - 1,
    "mode": lambda runtime: runtime.supervisor.mode,
    "reason": lambda runtime: runtime.supervisor.reason,
    "reached": lambda runtime: runtime.task.reached,
    "attempted": lambda runtime: runtime.task.attempted,
}
"""Integer columns, with their readers: one number for all robots, or (B,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """One recorded vector of floating-point numbers.

    Attributes:
        name: of the column, and in /state.
        size: numbers of one robot, or as many as it has joints, in the order of `spec.joint_names`, or as a goal has.
        read: (B, size) after a tick.
        needs: capabilities of the robots that have it.
        in_state: written to the topic /state; other topics of `recording.py` name their columns. Event rings hold all.
    """

    name: str
    size: int | Literal["joints", "goal"] = "joints"
    read: Callable[[Runtime], Floats]
    needs: frozenset[Capability] = frozenset()
    in_state: bool = False


SIGNALS = (
    Signal(name="q", read=lambda runtime: runtime.state.q),
    Signal(name="qd", read=lambda runtime: runtime.state.qd),
    Signal(name="housing_c", read=lambda runtime: runtime.state.housing_c, in_state=True),
    Signal(name="winding_c", read=lambda runtime: runtime.state.winding_c, in_state=True),
    Signal(name="target", read=lambda runtime: runtime.action.value, in_state=True),
    Signal(name="q_sent", read=lambda runtime: runtime.setpoint.q),
    Signal(name="qd_sent", read=lambda runtime: runtime.setpoint.qd),
    Signal(name="qdd_sent", read=lambda runtime: runtime.setpoint.qdd),
    Signal(name="tau_sent", read=lambda runtime: runtime.command.tau),
    Signal(name="stiffness", read=lambda runtime: runtime.command.drive.kp, in_state=True),
    Signal(name="damping", read=lambda runtime: runtime.command.drive.kd, in_state=True),
    Signal(name="achieved", size="goal", read=lambda runtime: runtime.task.achieved, in_state=True),
    Signal(name="goal", size="goal", read=lambda runtime: runtime.task.goal, in_state=True),
    Signal(name="goal_position", size=3, read=lambda runtime: runtime.task.goal_position),
    Signal(
        name="tool",
        size=3,
        read=lambda runtime: runtime.tool.position,
        needs=frozenset({"tool"}),
        in_state=True,
    ),
    Signal(
        name="orientation",  # of the base in the world, estimated, w first
        size=4,
        read=lambda runtime: runtime.base.quat_wxyz,
        needs=frozenset({"floating_base"}),
        in_state=True,
    ),
)
"""SI units, temperatures in °C. `goal`, and `achieved` by the robot's estimate, are in the units of the task. The
stiffness sent to a drive that follows no angle is 0."""


def recorded_signals(spec: RobotSpec) -> tuple[Signal, ...]:
    """Return the signals that a robot with these capabilities has."""
    return tuple(signal for signal in SIGNALS if signal.needs <= spec.capabilities)


def row_type(spec: RobotSpec, goal_size: int) -> np.dtype[np.void]:
    """Return the type of one tick of one robot, under a task whose goals have so many numbers.

    Counters come first; all numbers are 8 bytes wide, so that rows can be seen as plain arrays of either kind.
    """
    sizes = {"joints": spec.n, "goal": goal_size}
    numbers = [
        (signal.name, np.float64, (signal.size if isinstance(signal.size, int) else sizes[signal.size],))
        for signal in recorded_signals(spec)
    ]
    return np.dtype([*((name, np.int64) for name in COUNTERS), *numbers])


class Ring:
    """Ring buffer of the last ticks at the control rate: an array (T, B) of `row_type`, the oldest overwritten."""

    def __init__(
        self, spec: RobotSpec, robots: int, row: np.dtype[np.void], *, seconds: float = RING_S
    ) -> None:
        """Allocate for B robots, in rows of `row_type` or of a type that adds columns to it."""
        self.rows: Rows = np.zeros((round(seconds / spec.dt), robots), dtype=row)
        self._ticks, self._counters = 0, tuple(COUNTERS.values())
        self._readers = tuple(signal.read for signal in recorded_signals(spec))
        plain = (*self.rows.shape, -1)
        integers = self.rows.view(np.int64).reshape(plain).transpose(0, 2, 1)
        self._integers = integers[:, : len(COUNTERS)]
        self._numbers = self.rows.view(np.float64).reshape(plain)[:, :, len(COUNTERS) :]

    def step(self, runtime: Runtime, extra: tuple[Floats | Bools, ...] = ()) -> Rows:
        """Record the tick that has just ended; return its rows (B,). `extra`: added columns (B, ...)."""
        self._ticks = runtime.ticks
        at = (self._ticks - 1) % len(self.rows)
        for place, read in zip(self._integers[at], self._counters, strict=True):
            place[...] = read(runtime)
        # All at once: a field at a time takes twice as long.
        numbers = (*(read(runtime) for read in self._readers), *extra)
        np.concatenate(numbers, axis=1, out=self._numbers[at])
        rows: Rows = self.rows[at]
        return rows

    def last(self) -> Rows:
        """Return a copy (≤ T, B) in the order of time."""
        count = min(self._ticks, len(self.rows))
        return self.rows[np.arange(self._ticks - count, self._ticks) % len(self.rows)]


def state_schema() -> dict[str, Any]:
    """Return the JSON schema of the topic /state."""
    numbers = {"type": "array", "items": {"type": ["number", "null"]}}
    texts, counts = (
        dict.fromkeys(("mode", "reason"), "string"),
        dict.fromkeys(("reached", "attempted"), "integer"),
    )
    return {
        "title": "firstshift.State",
        "type": "object",
        "properties": {name: {"type": kind} for name, kind in (texts | counts).items()}
        | {signal.name: numbers for signal in SIGNALS if signal.in_state},
    }
