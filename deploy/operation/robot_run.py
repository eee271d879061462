"""One robot's shift: armed, at work, brought to rest. The one place that catches everything and stops the robot."""

import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import FrameType

import numpy as np

from deploy.operation.loop_timing import Pace
from deploy.operation.signals import handled
from deploy.runtime import Runtime
from deploy.safety.diagnostics import Stops, Why, blame
from deploy.safety.supervisor import CATEGORY_1
from deploy.state import Reason
from deploy.telemetry.recorder import Recorder
from robots.arrays import Floats

ARM_WITHIN_S = 1.0
"""Robot time in which the checks before arming must all have passed."""
STOP_SLACK_S = 4.0
"""Robot time in which a controlled stop must have ended, beyond what the longest one takes."""
ECHO_S = 0.5
"""Wall time after a signal in which another is no new wish, unless it is a Ctrl-C."""
STOPS_SHOWN = 4


class Ending(Enum):
    """How a shift ended."""

    DONE = "done"
    INTERRUPTED = "interrupted"
    STOPPED = "stopped"
    REFUSED = "not armed"
    FAILED = "failed"


class Interrupts:
    """Ctrl-C, termination, a lost terminal, counted: the first waits for the tick, one that follows cuts through.

    A terminal that closes may say so twice in the same millisecond: that counts as one.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Nothing is asked yet.

        Args:
            now: s, a monotonic clock.
        """
        self.count, self._now, self._first, self._cut = 0, now, np.inf, False

    def __call__(self, which: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        self.count += 1
        self._first = min(self._first, self._now())
        meant = self.count > 1 and (which == signal.SIGINT or self._now() > self._first + ECHO_S)
        if meant and not self._cut:
            self._cut = True
            raise KeyboardInterrupt


@dataclass(slots=True, kw_only=True)
class Tally:
    """What the summary counts.

    Attributes:
        stops: stops by reason. last: the newest of them in words, with their time.
        housing_max_c, winding_max_c: °C, the hottest motor of all ticks, as believed; None before the first.
    """

    stops: Counter[str] = field(default_factory=Counter)
    last: deque[str] = field(default_factory=lambda: deque(maxlen=STOPS_SHOWN))
    housing_max_c: float | None = None
    winding_max_c: float | None = None
    _stops: Stops = field(default_factory=Stops)

    def step(self, runtime: Runtime, why: str) -> None:
        """Count the tick that has just ended, and why the robot does not run, in words."""
        self.housing_max_c = _hotter(self.housing_max_c, runtime.state.temperature)
        self.winding_max_c = _hotter(self.winding_max_c, runtime.state.winding)
        if 0 in self._stops.begun(runtime):
            reason = int(runtime.supervisor.reason[0])
            self.stops.update(bit.name.lower() for bit in Reason(reason) if bit.name)
            self.last.append(f"{runtime.t:.2f} s: {why}")


def _hotter(so_far: float | None, now: Floats) -> float | None:
    hottest = float(now.max())
    if not np.isfinite(hottest):  # nobody knows yet
        return so_far
    return hottest if so_far is None else max(so_far, hottest)


class Shift:
    """Ticks robot 0 of a runtime from arming to rest."""

    def __init__(
        self,
        runtime: Runtime,
        pace: Pace,
        recorder: Recorder,
        *,
        duration: float,
        watchers: Sequence[Callable[["Shift"], None]] = (),
    ) -> None:
        """Nothing moves before `live`.

        Args:
            runtime: disarmed.
            pace: of its ticks.
            recorder: fed after each tick.
            duration: s of robot time from arming to the stop; may be infinite.
            watchers: called after each tick, when all of its work is done.
        """
        self.runtime, self.pace, self.recorder, self.tally = runtime, pace, recorder, Tally()
        self.ending: Ending | None = None
        self.interrupts, self._why = Interrupts(), Why()
        self._all = np.ones(runtime.robot.robots, dtype=bool)
        self._duration, self._t_end, self._t_rest = duration, np.inf, np.inf
        self._watchers, self._refused, self._stop_s = watchers, 0, runtime.spec.stop_s + STOP_SLACK_S

    @property
    def left(self) -> float | None:
        """Robot time until the stop at the end, s; None if there is no end."""
        return max(0.0, self._t_end - self.runtime.t) if np.isfinite(self._t_end) else None

    @property
    def reason(self) -> str:
        """Why the robot does not run, in words."""
        return blame(self.runtime, self._refused) if self._refused else str(self._why)

    def live(self) -> Ending:
        """Arm, work, and come to rest, whatever happens."""
        with handled(self.interrupts):
            try:
                if self._armed():
                    self._work()
            except BaseException:
                self.runtime.robot.stop(self._all)
                self.ending = Ending.FAILED
                self.recorder.event()
                raise
        self.ending = self._ending()
        return self.ending

    def _ending(self) -> Ending:
        """What was asked for, unless the robot had a reason of its own to latch."""
        own = int(self.runtime.supervisor.reason[0]) & CATEGORY_1 & ~Reason.OPERATOR
        if self.ending is None or (own and self.ending is Ending.DONE):
            return Ending.STOPPED
        return self.ending

    def _armed(self) -> bool:
        """Tick with brakes on until every check passes, or give up."""
        t_last = self.runtime.t + ARM_WITHIN_S
        while not self.interrupts.count:
            self._tick()
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
            self._decide()
            self._tick()
            if self.runtime.t > self._t_rest:
                raise RuntimeError(f"no rest within {self._stop_s:.1f} s of asking for a stop")

    def _decide(self) -> None:
        """Ask for a controlled stop when it is time for one."""
        if self.interrupts.count and self.ending is not Ending.INTERRUPTED:
            self._end(Ending.INTERRUPTED, Reason.OPERATOR)
        elif self.ending is None and self.runtime.t >= self._t_end:
            self._end(Ending.DONE, Reason.OPERATOR)
        elif self.ending is None and self.pace.overrun:
            self._end(Ending.STOPPED, Reason.OVERRUN)

    def _end(self, ending: Ending, reason: Reason) -> None:
        self.ending = ending
        self._t_rest = min(self._t_rest, self.runtime.t + self._stop_s)
        self.runtime.stop(reason)
        if ending is Ending.INTERRUPTED:
            self.recorder.event()

    def _tick(self) -> None:
        self.pace.wait()
        self.runtime.tick()
        self._why.step(self.runtime)
        why = str(self._why)
        self.recorder.step(self.runtime, why)
        self.tally.step(self.runtime, why)
        for watch in self._watchers:
            watch(self)
