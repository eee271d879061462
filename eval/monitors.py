"""The judge: decides from ground truth and from what was sent, and shares no code with what enforces.

Everything is brought to a load, a fraction of its limit, in one array (B, C) and compared once. NaN is bad.
Speed, acceleration and jerk of the commands are backward differences of the angles sent. On a continuous
trajectory each is a mean of the true derivative, weighted by a B-spline, so it stays within what the
trajectory keeps to. Source: de Boor, A Practical Guide to Splines (1978), ch. IX.
"""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Stage
from deploy.state import Bools, Command, Floats, Ints, Mode, Target
from eval.counts import JOINT_MONITORS, NAMES, REASONS, ROBOT_MONITORS, Counts
from eval.truth import Truth
from robots.spec import RobotSpec

REARM_S = 0.5
GOAL_M = 0.02
GOAL_S = 4.0
EVENTS_KEPT = 4
MOVING = 0.01
# Rounding, and the 1e-8 rad/s by which a planner may nudge its state: 2e-6 of the jerk limit at 200 Hz.
SENT_TOLERANCE = 1e-4
# A drive cannot exceed its range, it saturates at the end of it: that is the event.
TORQUE_FULL = 0.999
# Of what was sent, by order. With tracking before them they look at 1, 2, 3 and 4 ticks, all with power.
_DIFFERENCES = ("velocity_sent", "acceleration", "jerk")
_LOOKS_AT = np.array([1, 2, 3, 4])
# Numpy compares with an array of the same type ten times as fast as with an enum, twice as fast as with a number.
_RUNNING, _STOPPING = (np.array(mode, dtype=np.int8) for mode in (Mode.RUNNING, Mode.STOPPING))
_ALLOWED, _MOVING = np.array(1.0), np.array(MOVING)
_COUNTED = (
    *("ticks", "invalid", "running", "moving", "stops", "reasons", "attempted", "reached"),
    *("bad_ticks", "events", "worst", "log_start", "log_last", "log_worst"),
)


class Judge(Stage):
    """Every monitor, on every tick, for every robot."""

    carried: ClassVar[tuple[str, ...]] = (*_COUNTED, "last_bad", "blind", "sent", "mode", "goal")

    def __init__(self, spec: RobotSpec, torque_max: Floats, robots: int, *, goal_s: float = GOAL_S) -> None:
        """Allocate.

        Args:
            spec: limits and margins.
            torque_max: (n,) N·m, each actuator's range at the joint.
            robots: B.
            goal_s: s that the task gives to a goal.
        """
        self._dt, self._joints, self._goal_s = spec.dt, spec.joint_names, goal_s
        self._limits = _limits(spec, torque_max)
        self._gap = round(REARM_S / spec.dt)
        self._allocate(robots, len(self._limits))
        self._measured(robots, spec.n)
        middle = (spec.joint_array("q_max") + spec.joint_array("q_min")) / 2
        # Numpy takes three times as long where operands differ in shape.
        self._to_load = np.tile(1.0 / _raw(self._limits, spec), (robots, 1))
        self._middle = np.tile(middle, (robots, 1))
        self._centre = np.tile(spec.workspace.centre, (robots, 1))
        self._depth = np.full(robots, spec.workspace.radius_max + spec.workspace.z_min)

    def _allocate(self, robots: int, channels: int) -> None:
        self.invalid, self.stops, self.attempted, self.reached = np.zeros((4, robots), dtype=np.int64)
        self._tally, self._now = np.zeros((2, robots, 3), dtype=np.int64)
        self._now[:, 0] = 1
        self.ticks, self.running, self.moving = self._tally.T
        _, self._running, self._moving = self._now.T
        self.reasons = np.zeros((robots, len(REASONS)), dtype=np.int64)
        # Ticks that have yet to pass before every difference lies within ticks with power.
        self.blind = np.full(robots, len(_LOOKS_AT))
        self.mode = np.full(robots, Mode.DISARMED, dtype=np.int8)
        self.goal = np.zeros((robots, 3))
        self.bad_ticks, self.events = np.zeros((2, robots, channels), dtype=np.int64)
        self.last_bad = np.full((robots, channels), -self._gap - 1)
        self.worst, self._load = np.zeros((2, robots, channels))
        self._fine = np.ones((robots, channels), dtype=bool)
        self.log_start, self.log_last = np.full((2, robots, channels, EVENTS_KEPT), -1)
        self.log_worst = np.zeros((robots, channels, EVENTS_KEPT))

    def _measured(self, robots: int, n: int) -> None:
        """What is measured, monitor by monitor (K, B, ...); loads are robot by robot (B, C)."""
        many = len(JOINT_MONITORS)
        self._value, self._tool = np.zeros((many, robots, n)), np.zeros((2, robots, 3))
        self._at = {monitor.name: value for monitor, value in zip(JOINT_MONITORS, self._value, strict=True)}
        before = np.zeros((len(_DIFFERENCES), robots, n))
        self.sent = before.transpose(1, 0, 2)
        self._ladder = [(last, self._at[name]) for last, name in zip(before, _DIFFERENCES, strict=True)]
        self._joint = self._load[:, : many * n].reshape(robots, many, n)
        self._collision, self._place, _ = self._load[:, many * n :].T
        self._tool_load = self._load[:, many * n + 1 :]
        self._of_sent = self._joint[:, NAMES.index("tracking") :]
        self._speed_sent = self._joint[:, NAMES.index("velocity_sent")]

    @np.errstate(over="ignore", invalid="ignore")
    def step(
        self,
        *,
        truth: Truth,
        target: Target,
        command: Command,
        mode: NDArray[np.integer],
        reason: Ints,
        goal: Floats,
        attempted: Ints,
    ) -> None:
        """Judge one tick.

        Args:
            truth: after the physics of this tick.
            target: what the policy asked for.
            command: what was sent in this tick.
            mode: (B,) of `Mode`. reason: (B,) bit sets of `Reason`.
            goal: (B, 3) m, the tool's present goal in the world.
            attempted: (B,) goals over so far. Where it rises, the goal of the tick before is over.
        """
        self._measure_joints(truth, target, command)
        self._measure_tool(truth)
        self._forget(truth.valid, command.powered)
        self._compare()
        self._count_time(truth.valid, mode)
        self._count_stops(mode, reason)
        self._count_goals(truth, goal, attempted)

    def counts(self) -> Counts:
        """Copies of what was found so far."""
        shared = {name: getattr(self, name).copy() for name in _COUNTED}
        return Counts(
            joints=self._joints, dt=self._dt, goal_s=self._goal_s, limits=self._limits.copy(), **shared
        )

    def _measure_joints(self, truth: Truth, target: Target, command: Command) -> None:
        at = self._at
        np.subtract(target.q, self._middle, out=at["position_requested"])
        np.subtract(truth.q, self._middle, out=at["position_soft"])
        at["position_hard"][...] = at["position_soft"]
        at["velocity"][...] = truth.qd
        at["torque"][...] = truth.tau
        at["heat_soft"][...] = at["heat_hard"][...] = truth.winding_c
        np.subtract(truth.q, command.q, out=at["tracking"])
        now = command.q
        for before, difference in self._ladder:
            np.subtract(now, before, out=difference)
            before[...] = now
            now = difference
        np.abs(self._value, out=self._value)
        self._joint[...] = self._value.transpose(1, 0, 2)

    def _measure_tool(self, truth: Truth) -> None:
        """Fill the channels of `ROBOT_MONITORS`, in their order; then bring all channels to loads."""
        tool = self._tool
        np.subtract(truth.tool_position, self._centre, out=tool[0])
        tool[1] = truth.tool_velocity
        self._collision[...] = truth.self_collision
        self._tool_load[...] = np.sqrt(np.einsum("kbi,kbi->bk", tool, tool))
        self._place[...] = np.maximum(self._place, self._depth - truth.tool_position[:, 2])
        self._load *= self._to_load

    def _forget(self, valid: Bools, powered: Bools) -> None:
        """Drop the loads of diverged robots, and of what looks at ticks without power."""
        live = powered & valid
        if np.count_nonzero(live) == live.size and not np.count_nonzero(self.blind):
            return
        self._load[~valid] = 0.0
        self.invalid += ~valid
        self.blind -= self.blind > 0
        self.blind[~live] = len(_LOOKS_AT)
        self._of_sent[self.blind[:, None] > len(_LOOKS_AT) - _LOOKS_AT] = 0.0

    def _compare(self) -> None:
        np.less_equal(self._load, _ALLOWED, out=self._fine)
        if np.count_nonzero(self._fine) < self._fine.size:
            self._record(np.flatnonzero(~self._fine))
        np.maximum(self.worst, self._load, out=self.worst)

    def _record(self, bad: NDArray[np.intp]) -> None:
        """Count bad channels (indices into B × C) and log the first events of each."""
        tick, load = self.ticks[0], self._load.reshape(-1)
        load[bad] = np.nan_to_num(load[bad], nan=np.inf, posinf=np.inf)
        last, events = self.last_bad.reshape(-1), self.events.reshape(-1)
        events[bad] += tick - last[bad] > self._gap
        last[bad] = tick
        self.bad_ticks.reshape(-1)[bad] += 1
        slot = events[bad] - 1
        kept = slot < EVENTS_KEPT
        at = bad[kept] * EVENTS_KEPT + slot[kept]
        start, worst = self.log_start.reshape(-1), self.log_worst.reshape(-1)
        start[at] = np.where(start[at] < 0, tick, start[at])
        self.log_last.reshape(-1)[at] = tick
        worst[at] = np.maximum(worst[at], load[bad[kept]])

    def _count_time(self, valid: Bools, mode: NDArray[np.integer]) -> None:
        running = (mode == _RUNNING) & valid
        self._running[...] = running
        self._moving[...] = running & (self._speed_sent > _MOVING).any(axis=1)
        self._tally += self._now

    def _count_stops(self, mode: NDArray[np.integer], reason: Ints) -> None:
        """A stop begins where STOPPING is entered, or where RUNNING is left for anything else."""
        changed = mode != self.mode
        if not np.count_nonzero(changed):
            return
        stop = changed & ((mode == _STOPPING) | (self.mode == _RUNNING))
        self.stops += stop
        self.reasons[:, 0] += stop & (reason == 0)
        self.reasons[:, 1:] += stop[:, None] & (reason[:, None] >> np.arange(len(REASONS) - 1)) & 1
        self.mode[:] = mode

    def _count_goals(self, truth: Truth, goal: Floats, attempted: Ints) -> None:
        """A goal is reached if the tool is there when its time is over, with the robot still at work."""
        over = attempted > self.attempted
        if np.count_nonzero(over):
            missed = np.linalg.norm(truth.tool_position - self.goal, axis=1)
            self.reached += over & (missed <= GOAL_M) & (self.mode == _RUNNING) & truth.valid
            self.attempted[:] = attempted
        self.goal[:] = goal


def _limits(spec: RobotSpec, torque_max: Floats) -> Floats:
    """(C,) in the units of the monitors; positions are from the middle of the working range."""
    half = (spec.joint_array("q_max") - spec.joint_array("q_min")) / 2
    speed = spec.joint_array("qd_max")
    soft, hard = spec.motor_array("winding_soft_c"), spec.motor_array("winding_max_c")
    tracking = np.full(spec.n, spec.margins.tracking_rad)
    position = (half, half - spec.margins.q_soft_rad, half)
    sent = (speed, spec.joint_array("qdd_max"), spec.joint_array("qddd_max"))
    joint = (*position, speed, TORQUE_FULL * torque_max, soft, hard, tracking, *sent)
    robot = (0.5, spec.workspace.radius_max, spec.workspace.tool_speed_max)
    if (len(joint), len(robot)) != (len(JOINT_MONITORS), len(ROBOT_MONITORS)):
        raise ValueError(f"limits: {len(joint)} + {len(robot)}, monitors: {JOINT_MONITORS + ROBOT_MONITORS}")
    return np.concatenate([*joint, robot])


def _raw(limits: Floats, spec: RobotSpec) -> Floats:
    """(C,) limits of what is measured: of sent angles that is differences, not yet divided by dt."""
    raw, n = limits.copy(), spec.n
    for order, name in enumerate(_DIFFERENCES, start=1):
        channel = NAMES.index(name)
        raw[channel * n : (channel + 1) * n] *= spec.dt**order * (1 + SENT_TOLERANCE)
    return raw
