"""Ring buffer of judge inputs, evaluated 200 ticks at a time."""

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Arrays, Stage
from deploy.state import Command, State, Target
from deploy.truth import Truth
from robots.arrays import Bools, Floats, Ints

BLOCK_TICKS = 200
"""Ticks evaluated at once, to share the cost of numpy calls. Results do not depend on it."""
PAST = 3
"""Ticks kept from before the block: as many as a third difference needs."""

PerJoint = Annotated[Floats, float, "joints"]
Vector = Annotated[Floats, float, "xyz"]
Goal = Annotated[Floats, float, "goal"]
Number = Annotated[Floats, float]
Flag = Annotated[Bools, bool]
Integer = Annotated[Ints, np.int64]
Observation = Annotated[NDArray[np.float32], np.float32, "observation"]
"""Each with its dtype and its dimensions after ticks and robots: the buffer is allocated from them."""


class Ticks(NamedTuple):
    """Arrays (PAST + T, B, ...) of the arguments of `Judge.step`. The first `PAST` ticks were judged before.

    `target` is in the unit of the control mode. Of the command, `sent` are angles, `speed_sent` speeds, `tau_sent`
    feed-forward torques, `stiffness` N·m/rad and `damping` N·m·s/rad. `q_hat`, `q_var` and `age` are the estimate
    before the physics of that tick. `action_finite` is True where the policy was not called. `achieved` is what `goal`
    is compared with, by ground truth. `tilt`: rad, `base_height`: m, of the IMU above the floor. `fallen_s`: s with
    power after a fall. `allowed_contact` is the largest force of an allowed contact, as a share of its limit.
    """

    target: PerJoint
    q: PerJoint
    qd: PerJoint
    tau: PerJoint
    winding_c: PerJoint
    sent: PerJoint
    speed_sent: PerJoint
    tau_sent: PerJoint
    stiffness: PerJoint
    damping: PerJoint
    q_hat: PerJoint
    q_var: PerJoint
    tool_position: Vector
    tool_velocity: Vector
    achieved: Goal
    goal: Goal
    age: Number
    contact_n: Number
    tilt: Number
    base_height: Number
    fallen_s: Number
    allowed_contact: Number
    powered: Flag
    action_finite: Flag
    self_collision: Flag
    valid: Flag
    mode: Integer
    reason: Integer
    goal_number: Integer
    attempted: Integer
    observation: Observation

    def at(self, index: Any) -> "Ticks":
        """Return views of all arrays at an index."""
        arrays: Any = (array[index] for array in self)
        return Ticks(*arrays)


class TickBuffer(Stage):
    """Ticks that were not judged yet, and the `PAST` ticks before them.

    Before the first tick robots are disarmed, and all else is 0.

    Attributes:
        ticks: the arrays. pending: number of ticks appended and not yet judged.
    """

    def __init__(self, robots: int, n: int, observation: int, goal: int) -> None:
        """Allocate for B robots of n joints, observations and goals of so many numbers."""
        sizes = {"joints": n, "xyz": 3, "goal": goal, "observation": observation}
        arrays: dict[str, Any] = {}
        for name, kind in get_type_hints(Ticks, include_extras=True).items():
            dtype, *dimensions = kind.__metadata__
            shape = (PAST + BLOCK_TICKS, robots, *(sizes[each] for each in dimensions))
            arrays[name] = np.zeros(shape, dtype)
        self.ticks, self.pending = Ticks(**arrays), 0

    @property
    def row(self) -> int:
        """Index in `ticks` of the tick to be appended."""
        return PAST + self.pending

    def append(self, truth: Truth, state: State, target: Target, command: Command) -> None:
        """Append a tick (B, ...); the caller writes the other fields. Assignment by name is the fastest way."""
        ticks, row = self.ticks, self.row
        ticks.target[row] = target.value
        ticks.q[row] = truth.q
        ticks.qd[row] = truth.qd
        ticks.tau[row] = truth.tau
        ticks.winding_c[row] = truth.winding_c
        ticks.sent[row] = command.q
        ticks.speed_sent[row] = command.qd
        ticks.tau_sent[row] = command.tau
        ticks.q_hat[row] = state.q
        ticks.q_var[row] = state.q_var
        ticks.tool_position[row] = truth.tool_position
        ticks.tool_velocity[row] = truth.tool_velocity
        ticks.age[row] = state.age
        ticks.contact_n[row] = truth.contact_n
        ticks.powered[row] = command.powered
        ticks.stiffness[row] = command.drive.kp
        ticks.damping[row] = command.drive.kd
        ticks.self_collision[row] = truth.self_collision
        ticks.valid[row] = truth.valid
        self.pending += 1

    def pending_ticks(self, robots: int) -> Ticks:
        """Return views of the pending ticks of the first robots, and of the `PAST` ticks before."""
        return self.ticks.at((slice(PAST + self.pending), slice(robots)))

    def clear(self) -> None:
        """Drop all but the last `PAST` ticks."""
        for array in self.ticks:
            array[:PAST] = array[self.pending : self.pending + PAST]
        self.pending = 0

    def save(self) -> Arrays:
        """Return copies of the past (B, PAST, ...); pending ticks must have been judged before."""
        return {name: array.copy() for name, array in self._past().items()}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore a saved past, bit for bit, and drop pending ticks."""
        for name, array in self._past().items():
            array[...] = arrays[name]
        self.pending = 0

    def _past(self) -> dict[str, NDArray[Any]]:
        return {name: array[:PAST].swapaxes(0, 1) for name, array in self.ticks._asdict().items()}
