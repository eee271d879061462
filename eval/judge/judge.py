"""The judge: decides from ground truth and from what was sent, and shares no code with what enforces.

Ticks are written down as they come and judged some at a time, which changes nothing but the cost. Everything is
brought to a load, a fraction of its limit, in one row and compared once. NaN is bad.
"""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Observed
from deploy.stage import Arrays, Stage
from deploy.state import Command, Mode, State, Target
from eval.judge.counts import BINS, NAMES, REASONS, Counts
from eval.judge.events import Bad, Events
from eval.judge.limit_ratios import Block, Loads
from eval.judge.limits import load_limits
from eval.judge.tick_buffer import PAST, TOGETHER, Seen, Ticks
from eval.judge.truth import BaseTruth, Truth
from robots.arrays import Bools, Floats, Ints
from robots.spec import RobotSpec

REARM_S = 0.5
GOAL_M = 0.02
GOAL_S = 4.0
SPEED_M_S, TURN_RAD_S = 0.2, 0.3
"""By which the mean velocity over the ground, and the mean rate of turning, may miss what a robot with a base was asked
for."""
MOVING = 0.01
_COUNTED = (
    *("ticks", "invalid", "running", "moving", "stops", "reasons", "latches", "attempted", "reached"),
    *("worst", "bins"),
)
"""What `Counts` is told."""


class Judge(Stage):
    """Every monitor, on every tick, for every robot.

    Attributes:
        walked: (R, 3) m/s, m/s, rad/s, sum over the ticks since the last command, of robots with a base.
        worst: (R, C) highest load. bins: (C, BINS) loads by size, all robots together.
    """

    carried: ClassVar[tuple[str, ...]] = (*_COUNTED, "walked")
    parts = ("seen", "events")

    def __init__(
        self,
        spec: RobotSpec,
        torque_max: Floats,
        robots: int,
        *,
        counted: int | None = None,
        observed: Observed | None = None,
        goal_s: float = GOAL_S,
    ) -> None:
        """Allocate.

        Args:
            spec: limits and margins.
            torque_max: (n,) N·m, each actuator's range at the joint.
            robots: B.
            counted: R, how many of them are judged, the first ones; all by default.
            observed: what observations were like in the policy's training; without it that is not judged.
            goal_s: s that the task gives to a goal.

        Raises:
            ConfigError: the robot's limits.toml.
        """
        self._dt, self._joints, self._goal_s = spec.dt, spec.joint_names, goal_s
        self._robots, self._size = counted or robots, len(observed.mean) if observed else 0
        self._loads = Loads(spec, torque_max, load_limits(spec), observed, self._robots)
        self.seen = Seen(robots, spec.n, self._size)
        channels = len(self._loads.limits)
        self.events = Events(self._robots, spec.n, channels, round(REARM_S / spec.dt))
        self.ticks, self.invalid, self.running, self.moving = np.zeros((4, self._robots), dtype=np.int64)
        self.stops, self.latches, self.attempted, self.reached = np.zeros((4, self._robots), dtype=np.int64)
        self._walks, self.walked = spec.base is not None, np.zeros((self._robots, 3))
        self.reasons = np.zeros((self._robots, len(REASONS)), dtype=np.int64)
        self.worst, self.bins = np.zeros((self._robots, channels)), np.zeros((channels, BINS), dtype=np.int64)

    def step(
        self,
        *,
        truth: Truth,
        state: State,
        observation: NDArray[np.float32],
        target: Target,
        action: NDArray[np.floating] | None,
        command: Command,
        mode: NDArray[np.integer],
        reason: Ints,
        goal: Floats,
        attempted: Ints,
    ) -> None:
        """Judge one tick, soon; `counts` and `save` leave none waiting.

        Args:
            truth: after the physics of this tick.
            state: what was believed before it.
            observation: (B, N) the policy's newest.
            target: what the policy asked for.
            action: (B, A) what it was heard to say in this tick; None where it was not its turn.
            command: what was sent in this tick.
            mode: (B,) of `Mode`. reason: (B,) bit sets of `Reason`.
            goal: (B, 3) m, the tool's present goal in the world; of a robot with a base m/s forwards, m/s to the left
                and rad/s to the left.
            attempted: (B,) goals over so far. Where it rises, the goal of the tick before is over.
        """
        velocity, tilt = (truth.tool_velocity, 0.0) if truth.base is None else of_base(truth.base)
        # In the order of `Ticks`: names would cost as much as the writing.
        now: tuple[Any, ...] = (
            *(target.q, truth.q, truth.qd, truth.tau, truth.winding_c),
            *(command.q, command.tau, state.q, state.q_var),
            *(truth.tool_position, velocity, goal),
            *(state.age, truth.contact_n, tilt),
            *(command.powered, _sound(action), truth.self_collision, truth.valid),
            *(mode, reason, attempted, observation[:, : self._size]),
        )
        self.seen.put(now)
        if self.seen.waiting == TOGETHER:
            self._judge()

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _judge(self) -> None:
        """Judge the ticks that wait."""
        if not self.seen.waiting:
            return
        seen = self.seen.first(self._robots)
        block = self._loads.of(seen)
        self._compare(block)
        self.bins += self._loads.tally(block)
        self._count_time(seen, block)
        self._count_stops(seen)
        self._count_goals(seen)
        self.seen.turn()

    def counts(self) -> Counts:
        """Copies of what was found so far."""
        self._judge()
        events, kept = self.events, np.flatnonzero(self.events.start >= 0)
        order = np.lexsort((events.start[kept], events.channel[kept], events.robot[kept]))
        log = {f"log_{name}": getattr(events, name)[kept[order]] for name in Events.OF_EACH}
        return Counts(
            joints=self._joints,
            dt=self._dt,
            goal_s=self._goal_s,
            limits=self._loads.limits.copy(),
            bad_ticks=events.bad_ticks.copy(),
            events=events.events.copy(),
            **{name: getattr(self, name).copy() for name in _COUNTED},
            **log,
        )

    def save(self) -> Arrays:
        """Copies of every carried array."""
        self._judge()
        return super().save()

    def _compare(self, block: Block) -> None:
        peak = block.peak()
        if not (peak <= 1.0).all():
            np.copyto(block.everything, np.inf, where=np.isnan(block.everything))
            peak = block.peak()
            self.events.record(_bad(block, int(self.ticks[0])))
        np.maximum(self.worst, peak, out=self.worst)

    def _count_time(self, seen: Ticks, block: Block) -> None:
        valid = seen.valid[PAST:]
        running = (seen.mode[PAST:] == int(Mode.RUNNING)) & valid
        sent = block.joints[NAMES.index("velocity_sent")].reshape(*valid.shape, -1)
        self.ticks += len(running)
        self.invalid += (~valid).sum(axis=0)
        self.running += running.sum(axis=0)
        self.moving += (running & (sent.max(axis=2) > MOVING)).sum(axis=0)

    def _count_stops(self, seen: Ticks) -> None:
        """A stop begins where STOPPING is entered, or where RUNNING is left for anything else."""
        before, now = seen.mode[PAST - 1 : -1], seen.mode[PAST:]
        changed = now != before
        if not changed.any():
            return
        stop = changed & ((now == int(Mode.STOPPING)) | (before == int(Mode.RUNNING)))
        self.latches += (changed & (now == int(Mode.LATCHED))).sum(axis=0)
        for tick in np.flatnonzero(stop.any(axis=1)):
            reason = seen.reason[PAST + tick]
            self.stops += stop[tick]
            self.reasons[:, 0] += stop[tick] & (reason == 0)
            self.reasons[:, 1:] += stop[tick][:, None] & (reason[:, None] >> np.arange(len(REASONS) - 1)) & 1

    def _count_goals(self, seen: Ticks) -> None:
        """A goal is reached if the tool is there when its time is over, with the robot still at work.

        One of a robot with a base is a speed, and reached if that was its mean over the time.
        """
        over = seen.attempted[PAST:] > seen.attempted[PAST - 1 : -1]
        at_work = (seen.mode[PAST:] == int(Mode.RUNNING)) & seen.valid[PAST:]
        if self._walks:
            self._count_speeds(seen, over, at_work)
        elif over.any():
            missed = np.linalg.norm(seen.tool_position[PAST:] - seen.goal[PAST - 1 : -1], axis=2)
            self.reached += (over & (missed <= GOAL_M) & at_work).sum(axis=0)
        self.attempted[:] = seen.attempted[-1]

    def _count_speeds(self, seen: Ticks, over: Bools, at_work: Bools) -> None:
        """Add up what was walked since the last command, and compare its mean with what was asked for."""
        for tick, ended in enumerate(over):
            self.walked += seen.tool_velocity[PAST + tick]
            if ended.any():
                missed = self.walked * (self._dt / self._goal_s) - seen.goal[PAST + tick - 1]
                near = (np.hypot(*missed.T[:2]) <= SPEED_M_S) & (np.abs(missed[:, 2]) <= TURN_RAD_S)
                self.reached += ended & near & at_work[tick]
                self.walked[ended] = 0.0


def _sound(action: NDArray[np.floating] | None) -> Any:
    """(B,) whether what was said is numbers; who says nothing says nothing wrong."""
    return True if action is None else np.isfinite(action).all(axis=1)


def of_base(base: BaseTruth) -> tuple[Floats, Floats]:
    """(B, 3) m/s forwards, m/s to the left, rad/s to the left, over the floor; (B,) rad that it leans off gravity."""
    w, x, y, z = base.quat_wxyz.T
    # The first and the last column of the rotation: where the base's x and z axes point in the world.
    heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    upwards = 1.0 - 2.0 * (x * x + y * y)
    cos, sin, (vx, vy, _) = np.cos(heading), np.sin(heading), base.velocity.T
    # Of the last row of the rotation: how much of each axis of the base points upwards.
    up = np.stack((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), upwards), axis=1)
    turning = (up * base.angular_velocity).sum(axis=1)
    velocity = np.stack((cos * vx + sin * vy, cos * vy - sin * vx, turning), axis=1)
    # The last column: the base's z axis in the world.
    axis = np.stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), upwards), axis=1)
    return velocity, np.arccos(np.minimum(np.maximum((axis * base.up).sum(axis=1), -1.0), 1.0))


def _bad(block: Block, tick: int) -> Bad:
    """The bad ticks of a block that begins at `tick`."""
    n = block.joints.shape[2] // block.robots.shape[2]
    found = []
    for loads, first, each in ((block.joints, 0, n), (block.robots, len(block.joints) * n, 1)):
        for k in np.flatnonzero(~(loads <= 1.0).all(axis=(1, 2))):
            where = np.flatnonzero(~(loads[k] <= 1.0))
            after, place = np.divmod(where, loads.shape[2])
            robot, joint = np.divmod(place, each)
            load = loads[k].reshape(-1)[where]
            found.append(Bad(tick=tick + after, robot=robot, channel=first + k * each + joint, load=load))
    return Bad(*map(np.concatenate, zip(*found, strict=True)))
