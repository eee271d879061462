"""Contracts of the arm in position, velocity and torque mode, and adversaries: policies that do what harms."""

import numpy as np

from deploy.policy.contract_action import ActionSpec
from support.arm6 import SPEC
from support.contracts import arm_contract

SCALES = {
    "position": np.ones(SPEC.n),
    "velocity": SPEC.joint_array("qd_max"),
    "torque": np.array([60.0, 60.0, 60.0, 5.0, 5.0, 5.0]),
}


def mode_contract(mode, **changes):
    """A contract of one mode; full actions in position mode: 1 rad from the home pose."""
    offset = tuple(SPEC.joint_array("q_home").tolist()) if mode == "position" else None
    fields = {"mode": mode, "size": SPEC.n, "scale": tuple(SCALES[mode].tolist()), "offset": offset}
    action = ActionSpec(**{**fields, "clip": (-1.0, 1.0), **changes})
    return arm_contract(action=action)


class Adversary:
    """Random actions, pushes to all ends, or shaking with the joint's own speed."""

    def __init__(self, kind, shape, seed=0):
        self.kind, self.rng, self.step_number = kind, np.random.default_rng(seed), 0
        self.held = np.zeros(shape)

    def __call__(self, runtime):
        self.step_number += 1
        if self.kind == "shake":
            return np.sign(runtime.state.qd + 0.02 * np.sin(977.0 * runtime.state.q))
        if self.kind == "random":
            self.held = self.rng.uniform(-1, 1, self.held.shape)
        elif self.step_number % 100 == 1:
            self.held = self.rng.choice([-1.0, 1.0], self.held.shape)
        return self.held
