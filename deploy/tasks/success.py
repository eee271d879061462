"""Success of goals: the criterion by which a goal counts as reached, and its evaluation tick by tick.

The runtime evaluates it on its estimate, the judge on ground truth.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deploy.masks import any_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats, Ints


def euclidean(achieved: Floats, goal: Floats) -> Floats:
    """Return the length (...,) of the difference of (..., G) numbers."""
    return np.asarray(np.linalg.norm(achieved - goal, axis=-1))


class CoreGoals(NamedTuple):
    """Goals whose success is counted apart, too.

    Attributes:
        meaning: which goals these are, in words that follow "goals".
        contains: (K, G) goals to (K,) True for those among them.
    """

    meaning: str
    contains: Callable[[Floats], Bools]

    def among(self, ids: Bools, goal: Floats) -> Bools:
        """Return (R,) robots of `ids` (R,) whose goal (R, G) is a core goal."""
        core = ids.copy()
        core[ids] = self.contains(goal[ids])
        return core


@dataclass(frozen=True, slots=True, kw_only=True)
class SuccessCriterion:
    """Criterion by which a goal counts as reached.

    Attributes:
        size: G, numbers in a goal.
        period_s: s for each goal.
        tolerance: largest distance that counts, in the unit of `distance`.
        distance: (..., G) achieved and (..., G) goal to (...,).
        mean: compare the mean of what was achieved over the period, not its last value.
        core: goals that are counted apart as well; None for most tasks.
    """

    size: int
    period_s: float
    tolerance: float
    distance: Callable[[Floats, Floats], Floats] = euclidean
    mean: bool = False
    core: CoreGoals | None = None


class SuccessEvaluation(Stage):
    """Evaluation of a criterion for B robots.

    Attributes:
        total: (B, G) sum of what was achieved since the goal was given, where the criterion takes the mean.
    """

    carried = ("total",)

    def __init__(self, criterion: SuccessCriterion, robots: int, dt: float) -> None:
        self.criterion, self.total = criterion, np.zeros((robots, criterion.size))
        self._share = dt / criterion.period_s

    def reset(self, ids: Bools) -> None:
        """Begin anew for robots where `ids` (B,) holds."""
        self.total[ids] = 0.0

    def near(self, achieved: Floats, goal: Floats, ticks: Ints) -> Bools:
        """Return (B,) goals that would count as reached if their periods had been these `ticks` (B,), now over."""
        if self.criterion.mean:
            achieved = self.total / np.maximum(ticks, 1)[:, None]
        return np.asarray(self.criterion.distance(achieved, goal) <= self.criterion.tolerance)

    def step(self, achieved: Floats, goal: Floats, ended: Bools, running: Bools) -> Bools | None:
        """Count one tick, with (B, G) achieved; return (B,) goals that `ended` and were reached, None if none ended.

        Only robots `running` (B,) under their policy reach a goal.
        """
        if self.criterion.mean:
            self.total += achieved
        if not any_true(ended):
            return None
        if self.criterion.mean:
            achieved = self.total * self._share
            self.total[ended] = 0.0
        near = self.criterion.distance(achieved, goal) <= self.criterion.tolerance
        return np.asarray(ended & near & running)
