"""Stopwatch of methods: exclusive time of each."""

import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np


class Stopwatch:
    """Timer of wrapped methods; time in a nested wrapped method counts for that method only."""

    def __init__(self) -> None:
        self.samples: dict[str, list[float]] = {}
        self._nested = [0.0]

    def watch(self, name: str, owner: object, method: str) -> None:
        """Time `owner.method` under `name`."""
        setattr(owner, method, self._timed(name, getattr(owner, method)))

    def _timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        samples = self.samples.setdefault(name, [])

        @functools.wraps(call)
        def timed(*args: Any, **kwargs: Any) -> Any:
            self._nested.append(0.0)
            began = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                spent = time.perf_counter() - began
                samples.append(spent - self._nested.pop())
                self._nested[-1] += spent

        return timed

    def total(self, name: str) -> float:
        """Return the seconds spent under a name."""
        return float(np.sum(self.samples[name]))

    def clear(self) -> None:
        """Discard the samples; methods stay wrapped."""
        for samples in self.samples.values():
            samples.clear()
