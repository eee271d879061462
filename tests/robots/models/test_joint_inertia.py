"""Oracle: MuJoCo's mass matrix."""

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from robots.models.joint_inertia import joint_inertia
from support.arm6 import SPEC

POSES = 3000


def test_no_pose_of_the_arm_has_less_or_more_inertia():
    model = mujoco.MjModel.from_xml_path(str(SPEC.model_path))
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    rng, (low, high) = np.random.default_rng(1), SPEC.pose_range
    free, held = np.zeros((2, POSES, SPEC.n))
    for pose in range(POSES):
        data.qpos[:] = rng.uniform(low, high)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        free[pose], held[pose] = 1.0 / np.diag(np.linalg.inv(mass)), np.diag(mass)
    inertia = joint_inertia(SPEC)
    np.testing.assert_allclose(inertia.least, free.min(axis=0), rtol=0.03)
    np.testing.assert_allclose(inertia.most, held.max(axis=0), rtol=0.03)
