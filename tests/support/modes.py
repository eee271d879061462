"""Contracts of the arm in velocity and torque mode, and adversaries: policies that do what harms."""

import numpy as np

from deploy.policy.contract_action import ActionSpec
from support.arm6 import SPEC
from support.contracts import arm_contract

_ENDS = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
SCALES = {
    "position": (_ENDS[1] - _ENDS[0]) / 2,
    "velocity": SPEC.joint_array("qd_max"),
    "torque": np.array([60.0, 60.0, 60.0, 5.0, 5.0, 5.0]),
}


def mode_contract(mode, **changes):
    if mode == "position":
        changes = {"offset": tuple(SPEC.joint_array("q_home")), **changes}
    scale = tuple(SCALES[mode].tolist())
    action = ActionSpec(**{"mode": mode, "size": SPEC.n, "scale": scale, "clip": (-1.0, 1.0), **changes})
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
