"""Reward and shaping of a policy step, by ground truth."""

from dataclasses import dataclass

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
    q_target: Floats
    action_change: Floats
    action_excess: Floats
    manipulability: Floats
    running: Bools
    stopped: Bools


class Limits:
    """Working range of the joints, for rewards."""

    def __init__(self, spec: RobotSpec, near_share: float) -> None:
        """Centre and half width of every joint's range."""
        low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
        self._centre, self._half, self._near = (low + high) / 2, (high - low) / 2, near_share

    def beyond(self, q: Floats) -> Floats:
        """(B, n) rad outside the working range, 0 inside."""
        return np.maximum(np.abs(q - self._centre) - self._half, 0.0)

    def near(self, q: Floats) -> Bools:
        """(B, n) joints beyond the near share of their range."""
        return np.abs(q - self._centre) > self._near * self._half


def reward(step: Step, limits: Limits, w: Reward) -> tuple[Floats, Bools]:
    """Return (B,) the reward without shaping and (B,) robots with a joint out of range, which ends the episode."""
    broken = np.asarray((limits.beyond(step.q) > 0).any(axis=1))
    power = np.abs(step.tau * step.qd).sum(axis=1)
    jerk = np.linalg.norm(step.qdd_change, axis=1) / step.dt
    total = w.success * step.reached + w.joint_limit * broken + w.near_limit * limits.near(step.q).sum(axis=1)
    return total + w.power * power + w.jerk * jerk + w.survival, broken


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
