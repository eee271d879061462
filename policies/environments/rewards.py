"""Reward and shaping of a policy step, by ground truth."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from policies.training.recipe import Reward, Shaping
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Ground truth of one policy step of B robots.

    Attributes:
        q, qd: (B, n) rad, rad/s, true. tau: (B, n) N·m, true.
        qdd_change: (B, n) rad/s², of the sent setpoint over the step. dt: s, the step.
        distance: (B,) true distance to the goal, in the task's unit. reached: (B,) a goal ended, and was reached.
        near: (B,) the goal counts as reached, or would if its period had ended with the step.
        q_target: (B, n) rad, as requested. action_change: (B, n). action_excess: (B, n) beyond the action's clip.
        manipulability: (B,) at the true angles, as `Kinematics.manipulability`.
        running, stopped: (B,) may move; was stopped in this step.
    """

    q: Floats
    qd: Floats
    tau: Floats
    qdd_change: Floats
    dt: float
    distance: Floats
    reached: Bools
    near: Bools
    q_target: Floats
    action_change: Floats
    action_excess: Floats
    manipulability: Floats
    running: Bools
    stopped: Bools


class Limits:
    """Working range of the joints, for rewards and start poses."""

    def __init__(self, spec: RobotSpec, near_share: float) -> None:
        """Centre and half width of every joint's range; those of a turn to draw from, of a joint without ends."""
        low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
        (first, last), self._half, self._near = spec.pose_range, (high - low) / 2, near_share
        self._centre, self._half_drawn = (first + last) / 2, (last - first) / 2

    def beyond(self, q: Floats) -> Floats:
        """(B, n) rad outside the working range, 0 inside."""
        return np.maximum(np.abs(q - self._centre) - self._half, 0.0)

    def broken(self, q: Floats) -> Bools:
        """(B,) robots with any joint outside its working range, which ends the episode."""
        return np.asarray((self.beyond(q) > 0).any(axis=1))

    def draw(self, rng: np.random.Generator, share: float, robots: int) -> Floats:
        """Return poses (robots, n) rad, uniform in that share of every joint's range, around its middle."""
        spread = share * self._half_drawn
        return self._centre + rng.uniform(-spread, spread, (robots, len(spread)))

    def near(self, q: Floats) -> Bools:
        """(B, n) joints beyond the near share of their range."""
        return np.abs(q - self._centre) > self._near * self._half


class RewardTerms(NamedTuple):
    """Terms (B,) of the reward without shaping, named as in `Reward`."""

    success: Floats
    joint_limit: Floats
    near_limit: Floats
    power: Floats
    jerk: Floats
    survival: Floats

    @property
    def total(self) -> Floats:
        """(B,) the reward."""
        return self.success + self.joint_limit + self.near_limit + self.power + self.jerk + self.survival


def reward_terms(step: Step, limits: Limits, w: Reward) -> RewardTerms:
    """Return the terms of the reward without shaping."""
    power = np.abs(step.tau * step.qd).sum(axis=1)
    jerk = np.linalg.norm(step.qdd_change, axis=1) / step.dt
    return RewardTerms(
        success=np.asarray(w.success * step.reached, dtype=np.float64),
        joint_limit=np.asarray(w.joint_limit * limits.broken(step.q), dtype=np.float64),
        near_limit=w.near_limit * limits.near(step.q).sum(axis=1),
        power=w.power * power,
        jerk=w.jerk * jerk,
        survival=np.full(len(power), w.survival),
    )


def shaping(step: Step, limits: Limits, w: Shaping) -> Floats:
    """Return (B,) the shaping reward."""
    d = step.distance
    closeness = (
        (1 - np.tanh(d / w.far_m)) + (1 - np.tanh(d / w.near_m)) + w.here * np.exp(-((d / w.here_m) ** 2))
    )
    change = w.action_change * (step.action_change**2).sum(axis=1)
    change += w.action_excess * (step.action_excess**2).sum(axis=1)
    request = w.request * limits.beyond(step.q_target).sum(axis=1)
    singular = w.singular * np.maximum(1 - step.manipulability / w.singular_below, 0.0)
    return closeness * step.running + change + request + singular + w.stop * step.stopped
