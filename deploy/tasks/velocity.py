"""Velocity: walk as you are told, then as you are told next, for a whole shift."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deploy.masks import any_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.randomness import keyed, keys
from robots.spec import RobotSpec
from robots.tables import Base


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityConfig:
    """The task.

    Attributes:
        period_s: s for each command.
        tolerance: m/s, by which the mean speed over the ground may miss what was asked for.
        turning: rad/s, by which the mean rate of turning may.
    """

    period_s: float
    tolerance: float = 0.2
    turning: float = 0.3


class Velocity(Stage):
    """Commands of B robots: uniform in what a robot may be asked for.

    `reached` counts commands that were followed from beginning to end, as the robot itself believes: it was at work all
    the time, and its mean velocity was as asked.

    Attributes:
        goal: (B, 3) m/s forwards, m/s to the left, rad/s to the left.
        gone: (B, 3) as `goal`, sum over the ticks of what the robot believed that it did.
        worked: (B,) whether it has been at work since the command came.
    """

    carried = ("goal", "gone", "worked", "elapsed", "number", "attempted", "reached", "ended", "ended_goal")

    def __init__(self, spec: RobotSpec, base: Base, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Give every robot its first command.

        Args:
            spec: the robot. base: its base, which says what it may be asked for.
            seeds: B seeds.
        """
        self.config, robots = VelocityConfig(period_s=base.command_s), len(seeds)
        self._keys, self._period = keys(seeds, purpose=0), round(base.command_s / spec.dt)
        self._low, self._high = np.array(base.command_min), np.array(base.command_max)
        self.goal, self.ended_goal = np.zeros((robots, 3)), np.zeros((robots, 3))
        self.gone, self.worked = np.zeros((robots, 3)), np.ones(robots, dtype=bool)
        self.elapsed, self.number, self.attempted, self.reached = np.zeros((4, robots), dtype=np.int64)
        self.ended = np.zeros(robots, dtype=bool)
        self._choose(np.ones(robots, dtype=bool))

    @property
    def tolerance(self) -> float:
        """m/s, how near to what was asked for counts."""
        return self.config.tolerance

    def reset(self, ids: Bools) -> None:
        """A fresh command and a full period for robots where `ids` (B,) holds."""
        self.elapsed[ids], self.gone[ids], self.worked[ids] = 0, 0.0, True
        self._choose(ids)

    def step(self, velocity: Floats, running: Bools) -> None:
        """Count one tick.

        Args:
            velocity: (B, 3) as in `goal`, what the robot believes that it does.
            running: (B,) whether it is at work.
        """
        self.elapsed += 1
        self.gone += velocity
        self.worked &= running
        np.greater_equal(self.elapsed, self._period, out=self.ended)
        if not any_true(self.ended):
            return
        missed = self.gone / self._period - self.goal
        near = (np.hypot(*missed.T[:2]) <= self.config.tolerance) & (
            np.abs(missed[:, 2]) <= self.config.turning
        )
        self.attempted += self.ended
        self.reached += self.ended & near & self.worked
        self.ended_goal[self.ended] = self.goal[self.ended]
        self.reset(self.ended)

    def _choose(self, ids: Bools) -> None:
        for robot in np.flatnonzero(ids):
            rng = keyed(self._keys[robot], int(self.number[robot]))
            self.goal[robot] = rng.uniform(self._low, self._high)
            self.number[robot] += 1
