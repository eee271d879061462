"""Where the time of a tick goes: methods of live objects, each with its own exclusive time."""

import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np


class Stopwatch:
    """Times wrapped methods; what a wrapped method calls of other wrapped ones is theirs, not its own."""

    def __init__(self) -> None:
        """Nothing is watched yet."""
        self.samples: dict[str, list[float]] = {}
        self._inner = [0.0]

    def watch(self, name: str, owner: object, method: str) -> None:
        """Time `owner.method` under `name`."""
        setattr(owner, method, self._timed(name, getattr(owner, method)))

    def _timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        samples = self.samples.setdefault(name, [])

        @functools.wraps(call)
        def timed(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            began = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                spent = time.perf_counter() - began
                samples.append(spent - self._inner.pop())
                self._inner[-1] += spent

        return timed

    def total(self, name: str) -> float:
        """Seconds spent under a name."""
        return float(np.sum(self.samples[name]))

    def clear(self) -> None:
        """Forget what was measured, keep watching."""
        for samples in self.samples.values():
            samples.clear()
