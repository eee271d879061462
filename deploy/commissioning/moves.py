"""Motions of the check: each joint by itself, first by a nudge, then to and fro at constant speed."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from deploy.commissioning.packet_log import PacketLog
from deploy.commissioning.responses import Nudge, Response, Span, response
from deploy.operation.jog import Jog
from deploy.operation.robot_run import RobotRun
from deploy.runtime import Runtime
from deploy.state import Mode
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

NUDGE_RAD = float(np.deg2rad(0.5))
"""rad of the first motion of each joint, in both directions: too little to do harm."""
POWER_ON_S, REST_S, TURN_S = 0.5, 0.25, 0.05
"""s of rest after power came on, between the motions of a nudge, and between two passes. Packets take less than a
quarter of a second."""
PASSES = 4
"""Passes over the whole range of a joint, in alternating directions."""
ATTEMPTS = 3
"""Times that a motion is begun, if stops that clear themselves interrupt it."""
OWN, OTHERS = (0.5, 1.5), 0.35
"""Response of a joint's own encoder to its nudge, and largest of the others, at which the passes follow."""
JUMP_RAD = 0.01
"""rad by which an encoder may move when power comes on."""

T = TypeVar("T")
Ticks = Generator[None, None, T]
"""Motion that goes on for one tick each time, and has a result at its end."""


@dataclass(slots=True)
class JointMotion:
    """Motions of one joint, as ticks of the log.

    Attributes:
        begin: tick of the first motion; None if there was none.
        response: to the nudge; None if that did not come to its end.
        passes: over the whole range, all of them or none.
        stopped: reason for which the robot stopped, or the joint was not moved; empty if there is none.
    """

    begin: int | None = None
    response: Response | None = None
    passes: list[Span] = field(default_factory=list)
    stopped: str = ""


class CheckMoves:
    """Watcher of a run that moves the joints one after another, and then ends the run.

    Attributes:
        log: of the whole run. joints: what each joint did.
        powered: row of the first command with power; None before it.
        stopped: reason of a stop that came before the first motion; empty if there was none.
    """

    def __init__(self, jog: Jog, spec: RobotSpec, angle: float) -> None:
        """Take the robot at reduced speed, and rad by which each joint is moved either way."""
        self.log, self.joints = PacketLog(), [JointMotion() for _ in spec.joints]
        self.powered: int | None = None
        self.stopped = ""
        self._jog, self._spec, self._angle = jog, spec, angle
        margin = spec.margins.q_target_rad
        self._low, self._high = spec.joint_array("q_min") + margin, spec.joint_array("q_max") - margin
        self._program: Ticks[None] | None = None
        self._current: JointMotion | None = None
        self._interrupted = ""
        self._done = False

    def __call__(self, run: RobotRun) -> None:
        """Log the tick that has just ended, and go on with the motions while the robot runs."""
        self.log.add(run.runtime)
        mode = Mode(int(run.runtime.supervisor.mode[0]))
        if self.powered is None and mode != Mode.DISARMED:
            self.powered = len(self.log) - 1
        if mode == Mode.RUNNING and not self._done:
            self._program = self._program or self._all(run.runtime)
            self._done = next(self._program, self) is self
            if self._done:
                run.end()
        elif mode in (Mode.STOPPING, Mode.LATCHED) and not self._done:
            self._stop(run.reason)

    def _stop(self, reason: str) -> None:
        self._jog.stop()
        self._interrupted = self._interrupted or reason
        if self._current is None:
            self.stopped = self._interrupted
        else:
            self._current.stopped = self._interrupted

    @property
    def first_motion(self) -> int | None:
        """Row of the log at which the first joint began to move; None if none did."""
        return next((joint.begin for joint in self.joints if joint.begin is not None), None)

    @property
    def jumped(self) -> Bools:
        """(n,) encoders that moved when power came on, before anything was to move."""
        return np.asarray(np.abs(self.displacement) > JUMP_RAD)

    @property
    def displacement(self) -> Floats:
        """(n,) rad that encoders have moved from before power came on to the first motion or the last packet."""
        if self.powered is None:
            return np.zeros(self._spec.n)
        before, after = (
            self.log.packets("encoder", *rows)[2]
            for rows in ((0, self.powered), (self.powered, self.first_motion))
        )
        return np.asarray(after[-3:].mean(axis=0) - before.mean(axis=0))

    def _all(self, runtime: Runtime) -> Ticks[None]:
        yield from self._rest(POWER_ON_S)
        if self.stopped or self.jumped.any():
            return
        for joint, motion in enumerate(self.joints):
            self._current, motion.begin = motion, len(self.log)
            yield from self._joint(runtime, joint, motion)

    def _joint(self, runtime: Runtime, joint: int, motion: JointMotion) -> Ticks[None]:
        origin = float(runtime.setpoint.q[0, joint])
        low, high = (
            float(end[joint])
            for end in (
                np.maximum(origin - self._angle, self._low),
                np.minimum(origin + self._angle, self._high),
            )
        )
        if high - low < self._angle:
            motion.stopped = (
                f"not moved: {high - low:.3f} rad of room at {origin:.3f} rad, {self._angle:.3f} needed"
            )
            return
        nudge = yield from self._until_complete(motion, lambda: self._nudge(runtime, joint, high - origin))
        if nudge is None:
            return
        motion.response = response(self.log, nudge)
        if answers(motion.response, joint):
            passes = self._until_complete(motion, lambda: self._passes(runtime, joint, (low, high, origin)))
            motion.passes = (yield from passes) or []

    def _until_complete(self, motion: JointMotion, begin: Callable[[], Ticks[T]]) -> Ticks[T | None]:
        """Begin a motion again after a stop that cleared itself, at most `ATTEMPTS` times."""
        for _ in range(ATTEMPTS):
            self._interrupted = motion.stopped = ""
            result = yield from begin()
            if not self._interrupted:
                return result
        return None

    def _nudge(self, runtime: Runtime, joint: int, room: float) -> Ticks[Nudge]:
        step = NUDGE_RAD if room > NUDGE_RAD else -NUDGE_RAD
        yield from self._move(runtime, joint, step)
        yield from self._rest(REST_S)
        down = yield from self._move(runtime, joint, -step)
        low = yield from self._rest(REST_S)
        up = yield from self._move(runtime, joint, step)
        high = yield from self._rest(REST_S)
        yield from self._move(runtime, joint, -step)
        yield from self._rest(REST_S)
        return Nudge(joint, up, high, down, low)

    def _passes(self, runtime: Runtime, joint: int, ends: tuple[float, float, float]) -> Ticks[list[Span]]:
        low, high, origin = ends
        yield from self._move_to(runtime, joint, high)
        passes = []
        for number in range(PASSES):
            span = yield from self._move_to(runtime, joint, high if number % 2 else low)
            passes.append(span)
        yield from self._move_to(runtime, joint, origin)
        return passes

    def _move_to(self, runtime: Runtime, joint: int, angle: float) -> Ticks[Span]:
        span = yield from self._move(runtime, joint, angle - float(runtime.setpoint.q[0, joint]))
        yield from self._rest(TURN_S)
        return span

    def _move(self, runtime: Runtime, joint: int, distance: float) -> Ticks[Span]:
        begin = len(self.log)
        if not self._interrupted:
            self._jog.move(joint, distance)
        while self._jog.moving or not runtime.smoother.at_rest[0]:
            yield
        return Span(begin, len(self.log))

    def _rest(self, seconds: float) -> Ticks[Span]:
        begin = len(self.log)
        for _ in range(round(seconds / self._spec.dt)):
            yield
        return Span(begin, len(self.log))


def answers(response: Response, joint: int) -> bool:
    """Return True if a joint's own encoder answered its nudge about as it should, and no other did."""
    others = np.delete(response.encoder, joint)
    return bool(OWN[0] < response.encoder[joint] < OWN[1] and (np.abs(others) < OTHERS).all())
