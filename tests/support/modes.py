"""Contracts of the arm in position, velocity and torque mode."""

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
