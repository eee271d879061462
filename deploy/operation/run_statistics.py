"""Statistics of one run for its summary: stops by reason, and the hottest motor."""

from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from deploy.runtime import Runtime
from deploy.safety.diagnostics import StopDetector
from deploy.state import Reason
from robots.arrays import Floats

STOPS_SHOWN = 4


@dataclass(slots=True, kw_only=True)
class RunStatistics:
    """Counts and maxima over the ticks of one run.

    Attributes:
        stops: stops by reason. last_stops: the newest of them in words, with their time.
        housing_max_c, winding_max_c: °C, estimate for the hottest motor over all ticks; None before the first.
    """

    stops: Counter[str] = field(default_factory=Counter)
    last_stops: deque[str] = field(default_factory=lambda: deque(maxlen=STOPS_SHOWN))
    housing_max_c: float | None = None
    winding_max_c: float | None = None
    _stop_events: StopDetector = field(default_factory=StopDetector)

    def step(self, runtime: Runtime, reason: str) -> None:
        """Count the tick that has just ended; `reason` says in words why the robot does not run."""
        self.housing_max_c = _maximum(self.housing_max_c, runtime.state.temperature)
        self.winding_max_c = _maximum(self.winding_max_c, runtime.state.winding)
        if 0 in self._stop_events.step(runtime):
            bits = int(runtime.supervisor.reason[0])
            self.stops.update(bit.name.lower() for bit in Reason(bits) if bit.name)
            self.last_stops.append(f"{runtime.t:.2f} s: {reason}")


def _maximum(so_far: float | None, celsius: Floats) -> float | None:
    hottest = float(celsius.max())
    if not np.isfinite(hottest):  # not measured yet
        return so_far
    return hottest if so_far is None else max(so_far, hottest)
