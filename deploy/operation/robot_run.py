"""One robot's run from arming to rest. The only place that catches everything and stops the robot."""

from collections.abc import Callable, Sequence
from enum import Enum

import numpy as np

from deploy.operation.interrupts import Interrupts
from deploy.operation.loop_timing import LoopTiming
from deploy.operation.stop_explanation import StopExplanation, explain_reasons
from deploy.operation.summary import RunStatistics
from deploy.reasons import LATCHING, Reason
from deploy.runtime import Runtime
from deploy.telemetry.recorder import Recorder

ARM_AFTER_S = 0.2
"""Robot time in which estimates are averaged before a robot is armed."""
ARM_WITHIN_S = 1.0
"""Robot time within which all checks before arming must pass."""
STOP_SLACK_S = 4.0
"""Robot time that a controlled stop may take beyond the longest planned one."""


class Ending(Enum):
    """Result of a run."""

    DONE = "done"
    INTERRUPTED = "interrupted"
    STOPPED = "stopped"
    REFUSED = "not armed"
    FAILED = "failed"


class RobotRun:
    """Ticks robot 0 of a runtime from arming to rest.

    Attributes:
        ending: None until the run has ended.
        statistics: for the summary. lost: what of the run could not be kept, in words.
    """

    def __init__(
        self,
        runtime: Runtime,
        timing: LoopTiming,
        recorder: Recorder,
        *,
        interrupts: Interrupts,
        duration: float,
        watchers: "Sequence[Watcher]" = (),
    ) -> None:
        """Take a disarmed runtime and the s of robot time from arming to the stop; watchers see each finished tick.

        A signal that `interrupts` has counted asks for the stop; they are told while the robot may have power.
        """
        self.runtime, self.timing, self.recorder = runtime, timing, recorder
        self.statistics, self._interrupts = RunStatistics(), interrupts
        self.ending: Ending | None = None
        self.lost: list[str] = []
        self._stop_reasons, self._refused = StopExplanation(), 0
        self._all = np.ones(runtime.robot.robots, dtype=bool)
        self._duration, self._t_end, self._t_rest = duration, np.inf, np.inf
        self._watchers, self._stop_s = watchers, runtime.spec.stop_s + STOP_SLACK_S

    @property
    def time_left(self) -> float | None:
        """Robot time until the stop at the end, s; None if there is no end."""
        return max(0.0, self._t_end - self.runtime.t) if np.isfinite(self._t_end) else None

    @property
    def reason(self) -> str:
        """Reason in words why the robot does not run; empty while it runs."""
        return explain_reasons(self.runtime, self._refused) if self._refused else str(self._stop_reasons)

    def end(self) -> None:
        """Ask for the controlled stop at the end of a run now, whatever its duration."""
        self._duration, self._t_end = 0.0, min(self._t_end, self.runtime.t)

    def run(self) -> Ending:
        """Arm, work, and come to rest, whatever happens."""
        self._interrupts.powered = True
        try:
            if self._armed():
                self._work()
        except BaseException:
            self._interrupts.powered = False  # first: no Ctrl-C shall keep power on
            self.runtime.robot.stop(self._all)
            self.ending = Ending.FAILED
            self.recorder.event()
            raise
        self._interrupts.powered = False
        self.ending = self._final_ending()
        return self.ending

    def _final_ending(self) -> Ending:
        """Return the ending that was asked for, unless the robot latched for a reason of its own."""
        own = int(self.runtime.supervisor.reason[0]) & LATCHING & ~Reason.OPERATOR
        if self.ending is None or (own and self.ending is Ending.DONE):
            return Ending.STOPPED
        return self.ending

    def _armed(self) -> bool:
        """Tick with brakes on until every check passes, or give up."""
        t_first, t_last = self.runtime.t + ARM_AFTER_S, self.runtime.t + ARM_WITHIN_S
        while not self._interrupts.count:
            self._tick()
            if self.runtime.t < t_first:
                continue
            refused = self.runtime.arm(self._all)
            if not refused.any():
                self._t_end = self.runtime.t + self._duration
                return True
            if self.runtime.t > t_last:
                self.ending = Ending.REFUSED
                self._refused = int(refused[0])
                return False
        self.ending = Ending.INTERRUPTED
        return False

    def _work(self) -> None:
        while self.runtime.supervisor.powered.any():
            self._stop_if_due()
            self._tick()
            if self.runtime.t > self._t_rest:
                raise RuntimeError(f"no rest within {self._stop_s:.1f} s of asking for a stop")

    def _stop_if_due(self) -> None:
        """Ask for a controlled stop after an interrupt, at the end of the duration, or after an overrun."""
        if self._interrupts.count and self.ending is not Ending.INTERRUPTED:
            self._stop(Ending.INTERRUPTED, Reason.OPERATOR)
        elif self.ending is None and self.runtime.t >= self._t_end:
            self._stop(Ending.DONE, Reason.OPERATOR)
        elif self.ending is None and self.timing.overrun:
            self._stop(Ending.STOPPED, Reason.OVERRUN)

    def _stop(self, ending: Ending, reason: Reason) -> None:
        self.ending = ending
        self._t_rest = min(self._t_rest, self.runtime.t + self._stop_s)
        self.runtime.stop(reason)
        if ending is Ending.INTERRUPTED:
            self.recorder.event()

    def _tick(self) -> None:
        if skipped := self.timing.wait():
            self.runtime.skip(np.full(self.runtime.robot.robots, skipped))
        self.runtime.tick()
        self._stop_reasons.step(self.runtime)
        reason = str(self._stop_reasons)
        self.recorder.step(self.runtime, reason)
        self.statistics.step(self.runtime, reason)
        for watch in self._watchers:
            watch(self)


Watcher = Callable[[RobotRun], None]
"""Called after each tick of a run."""
