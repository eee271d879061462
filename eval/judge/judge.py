"""The judge: monitors of ground truth and of the commands sent, without any code of the enforcer.

Ticks are buffered and judged in blocks, which changes nothing but the cost. Every value is divided by its limit, and
all ratios are compared with 1 at once. NaN is bad.
"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Observed
from deploy.stage import Arrays, Stage
from deploy.state import Command, Mode, State, Target
from deploy.tasks.success import SuccessCriterion, SuccessEvaluation
from deploy.truth import Truth
from eval.judge.channels import Channels
from eval.judge.counts import BINS, REASON_NAMES, Counts
from eval.judge.events import BadTicks, EventLog
from eval.judge.falls import FallCriterion
from eval.judge.limit_ratios import LimitRatios, RatioBlock
from eval.judge.limits import load_limits
from eval.judge.monitor import Monitor
from eval.judge.monitors import MONITORS
from eval.judge.tick_buffer import BLOCK_TICKS, TickBuffer
from eval.judge.tick_window import JudgedRobot, TickWindow
from robots.arrays import Bools, Floats, Ints
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

EVENT_GAP_S = 0.5
"""s between bad ticks of one event, at most."""
MOVING = 0.01
"""Share of a joint's speed limit above which it is in motion."""
_COUNTED = (
    *("ticks", "invalid", "running", "moving", "stops", "reasons", "latches", "attempted", "reached"),
    *("core_attempted", "core_reached", "worst", "bins"),
)
"""Attributes of the judge that are fields of `Counts`."""


class Judge(Stage):
    """All monitors of B robots, evaluated in every tick.

    Attributes:
        worst: (R, C) highest ratio. bins: (C, BINS) histogram of the ratios of all robots.
        fallen_s: (B,) s with power after a fall.
        ratios: evaluation of the monitors.
    """

    carried: ClassVar[tuple[str, ...]] = ("fallen_s", *_COUNTED)
    parts = ("buffer", "events", "score")

    def __init__(
        self,
        spec: RobotSpec,
        torque_max: Floats,
        robots: int,
        *,
        criterion: SuccessCriterion,
        mode: ControlMode = ControlMode.POSITION,
        counted: int | None = None,
        observed: Observed | None = None,
        monitors: Sequence[Monitor] = MONITORS,
    ) -> None:
        """Allocate.

        Args:
            spec: limits and margins. torque_max: (n,) N·m, each actuator's range at the joint. robots: B.
            criterion: rule by which the task's goals count as reached.
            mode: in which drives follow the policy.
            counted: R, number of robots that are judged, the first ones; all by default.
            observed: statistics of the observations in training; without them observations are not judged.
            monitors: the catalogue; `MONITORS` and any others. The robot gets those whose needs it meets.

        Raises:
            ConfigError: the robot's limits.toml.
        """
        self._dt = spec.dt
        self._robots, self._size = counted or robots, len(observed.mean) if observed else 0
        self._falls = FallCriterion(spec) if spec.base else None
        self.fallen_s = np.zeros(robots)
        self._force_max = np.array([pair.force_n for pair in spec.may_touch if pair.force_n is not None])
        self._channels = Channels.of_robot(spec, monitors, mode)
        judged = JudgedRobot(spec=spec, torque_max=torque_max, limits=load_limits(spec), observed=observed)
        self.ratios = LimitRatios(self._channels, judged, self._robots)
        self._sent_speed = [monitor.name for monitor in self._channels.catalogue].index("velocity_sent")
        self.buffer = TickBuffer(robots, spec.n, self._size, criterion.size)
        self.score = SuccessEvaluation(criterion, self._robots, spec.dt)
        channels = len(self.ratios.limits)
        self.events = EventLog(self._channels, self._robots, round(EVENT_GAP_S / spec.dt))
        self.ticks, self.invalid, self.running, self.moving = np.zeros((4, self._robots), dtype=np.int64)
        self.stops, self.latches, self.attempted, self.reached = np.zeros((4, self._robots), dtype=np.int64)
        self.core_attempted, self.core_reached = np.zeros((2, self._robots), dtype=np.int64)
        self.reasons = np.zeros((self._robots, len(REASON_NAMES)), dtype=np.int64)
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
        achieved: Floats,
        goal: Floats,
        goal_number: Ints,
        attempted: Ints,
    ) -> None:
        """Append one tick; it is judged with its block, or before `counts` and `save` return.

        Args:
            truth: after the physics of this tick. state: the estimate before it.
            observation: (B, N) the newest of the policy. target: the policy's newest.
            action: (B, A) the policy's output in this tick; None where it was not called.
            command: sent in this tick.
            mode: (B,) of `Mode`. reason: (B,) bit sets of `Reason`.
            achieved: (B, G) what goals are compared with, by ground truth. goal: (B, G) the present goals.
            goal_number: (B,) goals given so far. Where it rises, what was achieved before counts for none of the later.
            attempted: (B,) goals over so far. Where it rises, the goal of the tick before is over.
        """
        ticks, row = self.buffer.ticks, self.buffer.row
        ticks.tilt[row], ticks.base_height[row], ticks.fallen_s[row] = self._fall(truth, command)
        ticks.allowed_contact[row] = self._share_of_limit(truth)
        ticks.action_finite[row] = True if action is None else np.isfinite(action).all(axis=1)
        ticks.mode[row] = mode
        ticks.reason[row] = reason
        ticks.achieved[row] = achieved
        ticks.goal[row] = goal
        ticks.goal_number[row] = goal_number
        ticks.attempted[row] = attempted
        ticks.observation[row] = observation[:, : self._size]
        self.buffer.append(truth, state, target, command)
        if self.buffer.pending == BLOCK_TICKS:
            self._judge_pending()

    def _fall(self, truth: Truth, command: Command) -> tuple[Floats | float, Floats | float, Floats | float]:
        """Return (B,) rad of tilt, m of the IMU's height, and s with power after a fall; 0 without floating base.

        The time falls again, as fast as it rose, while a robot stands, and is 0 without power.
        """
        if truth.base is None or self._falls is None:
            return 0.0, 0.0, 0.0
        stand = self._falls.measure(truth.base)
        more = np.where(stand.fallen, self._dt, -self._dt)
        self.fallen_s[:] = np.where(command.powered, np.maximum(self.fallen_s + more, 0.0), 0.0)
        return stand.tilt, stand.height, self.fallen_s

    def _share_of_limit(self, truth: Truth) -> Floats | float:
        """(B,) largest force of an allowed contact as a share of its limit; 0 of a robot without such limits."""
        forces = truth.allowed_contact_n
        return 0.0 if forces is None else np.asarray((forces / self._force_max).max(axis=1))

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _judge_pending(self) -> None:
        if not self.buffer.pending:
            return
        window = TickWindow(self.buffer.pending_ticks(self._robots), self.ratios.robot)
        block = self.ratios.evaluate(window)
        self._compare(block)
        self.bins += self.ratios.histogram(block)
        self._count_time(window, block)
        self._count_stops(window)
        self._count_goals(window)
        self.buffer.clear()

    def counts(self) -> Counts:
        """Return copies of all counts so far."""
        self._judge_pending()
        events, logged = self.events, np.flatnonzero(self.events.start >= 0)
        order = np.lexsort((events.start[logged], events.channel[logged], events.robot[logged]))
        log = {f"log_{name}": getattr(events, name)[logged[order]] for name in EventLog.LOG}
        return Counts(
            channels=self._channels,
            dt=self._dt,
            goal_s=self.score.criterion.period_s,
            core_goals=core.meaning if (core := self.score.criterion.core) else "",
            limits=self.ratios.limits.copy(),
            bad_ticks=events.bad_ticks.copy(),
            events=events.events.copy(),
            **{name: getattr(self, name).copy() for name in _COUNTED},
            **log,
        )

    def save(self) -> Arrays:
        """Return copies of every carried array."""
        self._judge_pending()
        return super().save()

    def _compare(self, block: RatioBlock) -> None:
        peak = block.peak()
        if not (peak <= 1.0).all():
            np.copyto(block.flat, np.inf, where=np.isnan(block.flat))
            peak = block.peak()
            self.events.record(_bad_ticks(block, int(self.ticks[0])))
        np.maximum(self.worst, peak, out=self.worst)

    def _count_time(self, window: TickWindow, block: RatioBlock) -> None:
        valid = window.now.valid
        running = window.running & valid
        sent = block.joints[self._sent_speed].reshape(*valid.shape, -1)
        self.ticks += len(running)
        self.invalid += (~valid).sum(axis=0)
        self.running += running.sum(axis=0)
        self.moving += (running & (sent.max(axis=2) > MOVING)).sum(axis=0)

    def _count_stops(self, window: TickWindow) -> None:
        """A stop begins where STOPPING is entered, RUNNING is left for any other mode, or power is cut while arming."""
        before, now = window.before.mode, window.now.mode
        changed = now != before
        if not changed.any():
            return
        latched = changed & (now == int(Mode.LATCHED))
        stop = changed & ((now == int(Mode.STOPPING)) | (before == int(Mode.RUNNING)))
        stop |= latched & (before == int(Mode.ARMING))
        self.latches += latched.sum(axis=0)
        for tick in np.flatnonzero(stop.any(axis=1)):
            reason = window.now.reason[tick]
            self.stops += stop[tick]
            self.reasons[:, 0] += stop[tick] & (reason == 0)
            self.reasons[:, 1:] += (
                stop[tick][:, None] & (reason[:, None] >> np.arange(len(REASON_NAMES) - 1)) & 1
            )

    def _count_goals(self, window: TickWindow) -> None:
        """Count goals that are over. Where `attempted` rises, the goal of the tick before is over.

        Where more goals were given than are over, one was replaced before its end: its score goes.
        """
        before, now = window.before, window.now
        over, running = now.attempted > before.attempted, window.running & now.valid
        replaced = now.goal_number - before.goal_number > over
        for tick in range(len(over)) if self.score.criterion.mean else np.flatnonzero(over.any(axis=1)):
            self.score.reset(replaced[tick])
            reached = self.score.step(now.achieved[tick], before.goal[tick], over[tick], running[tick])
            if reached is not None:
                self.reached += reached
                self._count_core_goals(before.goal[tick], over[tick], reached)
        self.attempted[:] = now.attempted[-1]

    def _count_core_goals(self, goal: Floats, over: Bools, reached: Bools) -> None:
        """Count goals (R, G) that are `over` (R,), and those `reached` (R,), if they are core goals."""
        if self.score.criterion.core is None:
            return
        core = self.score.criterion.core.among(over, goal)
        self.core_attempted += core
        self.core_reached += core & reached


def _bad_ticks(block: RatioBlock, first_tick: int) -> BadTicks:
    """Return the bad ticks of a block that begins at `first_tick`."""
    n = block.joints.shape[2] // block.robots.shape[2]
    found = []
    for ratios, first, joints in ((block.joints, 0, n), (block.robots, len(block.joints) * n, 1)):
        for k in np.flatnonzero(~(ratios <= 1.0).all(axis=(1, 2))):
            where = np.flatnonzero(~(ratios[k] <= 1.0))
            tick, column = np.divmod(where, ratios.shape[2])
            robot, joint = np.divmod(column, joints)
            channel, ratio = first + k * joints + joint, ratios[k].reshape(-1)[where]
            found.append(BadTicks(tick=first_tick + tick, robot=robot, channel=channel, ratio=ratio))
    return BadTicks(*map(np.concatenate, zip(*found, strict=True)))
