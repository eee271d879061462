"""The judge's measure of a singularity against MuJoCo's own Jacobian, for six joints and for other numbers."""

import re

import numpy as np
import pytest

from support.arm6 import SPEC, copy_of_arm

pytest.importorskip("mujoco")

import mujoco

from eval.judge.singularity import SingularityMetric
from robots.models.mujoco_model import load_mujoco
from robots.spec import load_robot

HOME = SPEC.joint_array("q_home")
EXTRA = ' axis="0.6 0 0.8" pos="0.01 0.02 0.03"'


def jacobians(spec, q):
    """(M, 6, n) at the point where the last joint is."""
    model = load_mujoco(spec)
    data, found = mujoco.MjData(model), np.empty((len(q), 6, spec.n))
    for row, angles in zip(found, q, strict=True):
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jac(model, data, row[:3], row[3:], data.xanchor[-1], model.nbody - 1)
    return found


def poses(n, many, seed):
    return np.random.default_rng(seed).uniform(-3, 3, (many, n))


def test_measure_is_the_jacobian_determinant_with_the_sign_of_home():
    q = np.vstack((HOME, poses(6, 200, 0)))
    expected = np.linalg.det(jacobians(SPEC, q))
    np.testing.assert_allclose(
        SingularityMetric(SPEC).manipulability(q), expected * np.sign(expected[0]), rtol=0, atol=1e-14
    )
    assert (expected * expected[0] < 0).sum() > 20  # beyond a singularity


def with_joints(n, folder):
    """The arm without its last joints, which are stiff, or with a seventh in the last link."""
    path = copy_of_arm(folder)
    toml, xml = (path / "robot.toml").read_text(), (path / "model.xml").read_text()
    head, *joints = re.split(r"(?m)^(?=\[\[joints\]\])", toml)
    for name in SPEC.joint_names[n:]:
        xml = re.sub(f'<(joint|dcmotor) name="{name}".*?/>', "", xml)
    if n > 6:
        joints.append(joints[-1].replace('"wrist_3"', '"wrist_4"'))
        joint = '<joint name="wrist_3" class="size1"/>'
        motor = '<dcmotor name="wrist_3" joint="wrist_3" class="size1"/>'
        xml = xml.replace(joint, joint + joint.replace("wrist_3", "wrist_4").replace("/>", EXTRA + "/>"))
        xml = xml.replace(motor, motor + motor.replace("wrist_3", "wrist_4"))
    (path / "robot.toml").write_text(head + "\n".join(joints[:n]))
    (path / "model.xml").write_text(xml)
    return load_robot(path)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 7])
def test_measure_for_other_joint_counts_is_the_product_of_singular_values(n, tmp_path):
    spec, q = with_joints(n, tmp_path), poses(n, 20, n)
    expected = np.prod(np.linalg.svd(jacobians(spec, q), compute_uv=False), axis=1)
    assert expected.max() > 0.01
    np.testing.assert_allclose(SingularityMetric(spec).manipulability(q), expected, rtol=0, atol=1e-9)


def test_a_straight_wrist_or_elbow_is_a_singularity():
    wrist, elbow = HOME.copy(), HOME.copy()
    wrist[4], elbow[2] = 0.0, 0.0
    np.testing.assert_allclose(
        SingularityMetric(SPEC).manipulability(np.stack((wrist, elbow))), 0.0, atol=1e-15
    )


def test_home_pose_determines_the_sign(tmp_path):
    ends = ("q_min = -2.6\nq_max = -0.5\nq_home = -1.5708", "q_min = 0.5\nq_max = 2.6\nq_home = 1.5708")
    turned = load_robot(copy_of_arm(tmp_path, toml=[ends]))
    q = np.stack((HOME, turned.joint_array("q_home")))
    here, there = SingularityMetric(SPEC).manipulability(q)
    assert here > 0.05
    np.testing.assert_allclose(there, -here, rtol=1e-12)
    np.testing.assert_allclose(SingularityMetric(turned).manipulability(q), [-here, -there], rtol=1e-12)


@np.errstate(invalid="ignore")
def test_robots_are_independent_to_the_bit():
    axes, q = SingularityMetric(SPEC), poses(6, 300, 1)
    q[::7] = np.nan
    whole = axes.manipulability(q)
    assert np.isnan(whole).tolist() == [row % 7 == 0 for row in range(300)]
    for many in (1, 2, 3, 5, 8, 17, 64):
        parts = [axes.manipulability(q[row : row + many]) for row in range(0, 300, many)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
