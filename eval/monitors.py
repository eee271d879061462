"""The judge: decides from ground truth and from what was sent, and shares no code with what enforces.

Ticks are written down as they come and judged some at a time, which changes nothing but the cost. Everything is
brought to a load, a fraction of its limit, in one array (T, B, C) and compared once. NaN is bad.
Speed, acceleration and jerk of the commands are backward differences of the angles sent. On a continuous
trajectory each is a mean of the true derivative, weighted by a B-spline, so it stays within what the
trajectory keeps to. Source: de Boor, A Practical Guide to Splines (1978), ch. IX.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Arrays, Stage
from deploy.state import Command, Floats, Ints, Mode, Target
from eval.counts import JOINT_MONITORS, NAMES, REASONS, ROBOT_MONITORS, Counts
from eval.seen import TOGETHER, Seen
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
_DIFFERENCES = ("velocity_sent", "acceleration", "jerk")
_COUNTED = (
    *("ticks", "invalid", "running", "moving", "stops", "reasons", "latches", "attempted", "reached"),
    *("bad_ticks", "events", "worst", "log_start", "log_last", "log_worst"),
)


class Judge(Stage):
    """Every monitor, on every tick, for every robot."""

    carried: ClassVar[tuple[str, ...]] = (*_COUNTED, "last_bad", "sent", "live", "mode", "goal")

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
        self._to_load = 1.0 / _raw(self._limits, spec)
        self._middle = (spec.joint_array("q_max") + spec.joint_array("q_min")) / 2
        self._centre = np.array(spec.workspace.centre)
        self._depth = spec.workspace.radius_max + spec.workspace.z_min
        self._gap = round(REARM_S / spec.dt)
        self._allocate(robots, len(self._limits))
        self._seen, self._waiting = Seen.room(robots, spec.n), 0
        self._places = self._seen.arrays()
        self.sent = np.zeros((robots, len(_DIFFERENCES), spec.n))
        self.live = np.zeros((robots, len(_DIFFERENCES)), dtype=bool)

    def _allocate(self, robots: int, channels: int) -> None:
        self.ticks, self.invalid, self.running, self.moving = np.zeros((4, robots), dtype=np.int64)
        self.stops, self.latches, self.attempted, self.reached = np.zeros((4, robots), dtype=np.int64)
        self.reasons = np.zeros((robots, len(REASONS)), dtype=np.int64)
        self.mode = np.full(robots, Mode.DISARMED, dtype=np.int64)
        self.goal = np.zeros((robots, 3))
        self.bad_ticks, self.events = np.zeros((2, robots, channels), dtype=np.int64)
        self.last_bad = np.full((robots, channels), -self._gap - 1)
        self.worst = np.zeros((robots, channels))
        self.log_start, self.log_last = np.full((2, robots, channels, EVENTS_KEPT), -1)
        self.log_worst = np.zeros((robots, channels, EVENTS_KEPT))

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
        """Judge one tick, soon; `counts` and `save` leave none waiting.

        Args:
            truth: after the physics of this tick.
            target: what the policy asked for.
            command: what was sent in this tick.
            mode: (B,) of `Mode`. reason: (B,) bit sets of `Reason`.
            goal: (B, 3) m, the tool's present goal in the world.
            attempted: (B,) goals over so far. Where it rises, the goal of the tick before is over.
        """
        # In the order of `Seen`.
        now: tuple[Any, ...] = (
            *(target.q, truth.q, truth.qd, truth.tau, truth.winding_c, command.q),
            *(truth.tool_position, truth.tool_velocity, goal),
            *(command.powered, truth.self_collision, truth.valid, mode, reason, attempted),
        )
        for place, value in zip(self._places, now, strict=True):
            place[self._waiting] = value
        self._waiting += 1
        if self._waiting == TOGETHER:
            self._judge()

    @np.errstate(over="ignore", invalid="ignore")
    def _judge(self) -> None:
        """Judge the ticks that wait."""
        if not self._waiting:
            return
        seen = self._seen.first(self._waiting)
        load = self._loads(seen)
        self._compare(load)
        self._count_time(seen, load)
        self._count_stops(seen)
        self._count_goals(seen)
        self._waiting = 0

    def counts(self) -> Counts:
        """Copies of what was found so far."""
        self._judge()
        shared = {name: getattr(self, name).copy() for name in _COUNTED}
        return Counts(
            joints=self._joints, dt=self._dt, goal_s=self._goal_s, limits=self._limits.copy(), **shared
        )

    def save(self) -> Arrays:
        """Copies of every carried array."""
        self._judge()
        return super().save()

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit; what waited is forgotten."""
        self._waiting = 0
        super().restore(arrays)

    def _loads(self, seen: Seen) -> Floats:
        """(T, B, C) fractions of the limit, 0 where a channel cannot tell."""
        ticks, robots, n = seen.q.shape
        load, many = np.empty((ticks, robots, len(self._limits))), len(JOINT_MONITORS)
        self._joint_values(seen, load[:, :, : many * n].reshape(ticks, robots, many, n))
        tool = np.stack((seen.tool_position - self._centre, seen.tool_velocity), axis=2)
        load[:, :, -3] = seen.self_collision
        load[:, :, -2:] = np.sqrt(np.einsum("tbki,tbki->tbk", tool, tool))
        load[:, :, -2] = np.maximum(load[:, :, -2], self._depth - seen.tool_position[:, :, 2])
        np.abs(load, out=load)
        load *= self._to_load
        load[~seen.valid] = 0.0
        return load

    def _joint_values(self, seen: Seen, to: Floats) -> None:
        """Fill the channels of `JOINT_MONITORS` (T, B, K, n), in their order."""
        measured = (
            *(seen.target - self._middle, seen.q - self._middle, seen.q - self._middle),
            *(seen.qd, seen.tau, seen.winding_c, seen.winding_c),
        )
        for place, value in enumerate(measured):
            to[:, :, place] = value
        to[:, :, 0][~seen.powered] = 0.0  # nobody asks anything of a robot without power
        self._of_sent(seen, to[:, :, len(measured) :])

    def _of_sent(self, seen: Seen, to: Floats) -> None:
        """Tracking and the differences of what was sent (T, B, 4, n); 0 where one looks at a tick without power."""
        ticks = len(seen.q)
        sent = np.concatenate((self.sent.swapaxes(0, 1), seen.sent))
        live = np.concatenate((self.live.T, seen.powered & seen.valid))
        to[:, :, 0] = seen.q - seen.sent
        to[:, :, 0][~live[-ticks:]] = 0.0
        difference, whole = sent, live
        for order in range(1, 1 + len(_DIFFERENCES)):
            difference, whole = np.diff(difference, axis=0), whole[1:] & whole[:-1]
            to[:, :, order] = difference[-ticks:]
            to[:, :, order][~whole[-ticks:]] = 0.0
        self.sent[:] = sent[-len(_DIFFERENCES) :].swapaxes(0, 1)
        self.live[:] = live[-len(_DIFFERENCES) :].T

    def _compare(self, load: Floats) -> None:
        fine = load <= 1.0
        if not fine.all():
            load[~fine] = np.nan_to_num(load[~fine], nan=np.inf, posinf=np.inf)
            self._record(load.reshape(len(load), -1), ~fine.reshape(len(load), -1))
        np.maximum(self.worst, load.max(axis=0), out=self.worst)

    def _record(self, load: Floats, bad: NDArray[np.bool_]) -> None:
        """Count bad ticks of channels (T, B × C) and log the first events of each."""
        where = np.flatnonzero(bad)
        channel = where % bad.shape[1]
        order = np.argsort(channel, kind="stable")  # one channel after the other, each in the order of time
        where, channel = where[order], channel[order]
        tick = where // bad.shape[1] + self.ticks[0]
        begins, event = self._events(channel, tick)
        kept = event < EVENTS_KEPT
        at = channel[kept] * EVENTS_KEPT + event[kept]
        self.log_start.reshape(-1)[at[begins[kept]]] = tick[kept & begins]
        np.maximum.at(self.log_last.reshape(-1), at, tick[kept])
        np.maximum.at(self.log_worst.reshape(-1), at, load.reshape(-1)[where[kept]])

    def _events(self, channel: Ints, tick: Ints) -> tuple[NDArray[np.bool_], Ints]:
        """Count bad ticks, in order; whether each begins an event of its channel, and the index of its event."""
        here, first, many = np.unique(channel, return_index=True, return_counts=True)
        last, events = self.last_bad.reshape(-1), self.events.reshape(-1)
        before, end = np.roll(tick, 1), first + many - 1
        before[first] = last[here]
        begins = tick - before > self._gap
        so_far = np.cumsum(begins)
        number = so_far + np.repeat(events[here] - so_far[first] + begins[first], many)
        last[here], events[here] = tick[end], number[end]
        self.bad_ticks.reshape(-1)[here] += many
        return begins, number - 1

    def _count_time(self, seen: Seen, load: Floats) -> None:
        running = (seen.mode == int(Mode.RUNNING)) & seen.valid
        n, place = len(self._joints), NAMES.index("velocity_sent")
        moving = running & (load[:, :, place * n : (place + 1) * n] > MOVING).any(axis=2)
        self.ticks += len(running)
        self.invalid += (~seen.valid).sum(axis=0)
        self.running += running.sum(axis=0)
        self.moving += moving.sum(axis=0)

    def _count_stops(self, seen: Seen) -> None:
        """A stop begins where STOPPING is entered, or where RUNNING is left for anything else."""
        mode = np.concatenate((self.mode[None], seen.mode))
        before, now = mode[:-1], mode[1:]
        stop = (now != before) & ((now == int(Mode.STOPPING)) | (before == int(Mode.RUNNING)))
        self.latches += ((now != before) & (now == int(Mode.LATCHED))).sum(axis=0)
        self.mode[:] = mode[-1]
        for tick in np.flatnonzero(stop.any(axis=1)):
            reason = seen.reason[tick]
            self.stops += stop[tick]
            self.reasons[:, 0] += stop[tick] & (reason == 0)
            self.reasons[:, 1:] += stop[tick][:, None] & (reason[:, None] >> np.arange(len(REASONS) - 1)) & 1

    def _count_goals(self, seen: Seen) -> None:
        """A goal is reached if the tool is there when its time is over, with the robot still at work."""
        attempted = np.concatenate((self.attempted[None], seen.attempted))
        goal = np.concatenate((self.goal[None], seen.goal))[:-1]
        over = attempted[1:] > attempted[:-1]
        if over.any():
            missed = np.linalg.norm(seen.tool_position - goal, axis=2)
            at_work = (seen.mode == int(Mode.RUNNING)) & seen.valid
            self.reached += (over & (missed <= GOAL_M) & at_work).sum(axis=0)
        self.attempted[:], self.goal[:] = attempted[-1], seen.goal[-1]


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
