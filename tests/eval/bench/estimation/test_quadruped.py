"""The estimator of a floating base on a robot that really walks, in MuJoCo."""

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")

import mujoco

from eval.bench.estimation import floating
from eval.bench.estimation.quadruped import DT, MODEL, STAND, Gait, simulate_quadrupeds
from robots.randomness import robot_seed
from robots.rotations import exp, matrix

MOTIONS, DRAWS = 8, 128


@pytest.fixture(scope="module")
def truth():
    return simulate_quadrupeds([robot_seed(floating.SEED, robot) for robot in range(MOTIONS)], 3.0)


@pytest.fixture(scope="module")
def trots(truth):
    trots = floating.trotting(truth)
    assert 2 <= trots.sum() <= 6
    return np.tile(trots, DRAWS // MOTIONS)


@pytest.fixture(scope="module")
def followed(truth):
    return {feet: floating.estimate_base(truth, 0, DRAWS, feet=feet) for feet in (True, False)}


def rmse(followed, name, robots):
    return tuple(floating.rms(getattr(followed[feet], name)[:, robots]) for feet in (True, False))


@pytest.mark.slow
def test_robot_walks_without_falling(truth):
    up = matrix(truth.quat_wxyz.reshape(-1, 4))[:, 2, 2]
    assert up.min() > np.cos(0.5)
    assert np.abs(truth.velocity_in_world).max(axis=(0, 2)).min() > 0.05


@pytest.mark.slow
def test_tilt_and_velocity_are_far_better_than_by_integration(followed, trots):
    for robots, tilt_max, speed_max in ((~trots, 0.016, 0.03), (trots, 0.018, 0.06)):
        tilt, alone = rmse(followed, "gravity", robots)
        assert tilt < min(tilt_max, alone / 2)
        speed, alone = rmse(followed, "velocity", robots)
        assert speed < min(speed_max, alone / 10)


@pytest.mark.slow
def test_angular_velocity_is_better_without_its_bias(followed, trots):
    turning, alone = rmse(followed, "angular_velocity", ~trots)
    assert turning < min(0.025, 0.95 * alone)


@pytest.mark.slow
def test_error_is_consistent_with_the_covariance(followed):
    """Five errors: a foot that lands is neither white nor Gaussian, so the range is wide on purpose."""
    assert 3.0 < followed[True].nees.mean() < 8.0
    assert followed[True].refused < 0.01


@pytest.mark.slow
def test_feet_equal_pinocchio(truth):
    """What a caller computes from joint angles is what the filter is promised, in the base frame."""
    model, expected = pin.buildModelFromMJCF(str(MODEL)), mujoco.MjModel.from_xml_path(str(MODEL))
    rng, data, at = np.random.default_rng(0), model.createData(), mujoco.MjData(expected)
    joints, speeds = STAND + rng.normal(0, 0.2, 12), rng.normal(0, 1.0, 12)
    at.qpos[:], at.qvel[:] = (
        [1, 2, 3, *exp(rng.normal(size=(1, 3)))[0], *joints],
        [*rng.normal(size=6), *speeds],
    )
    mujoco.mj_forward(expected, at)
    still = [0, 0, 0, 0, 0, 0, 1, *joints]
    pin.forwardKinematics(model, data, np.array(still, dtype=float), np.concatenate([np.zeros(6), speeds]))
    pin.updateFramePlacements(model, data)
    feet = at.sensordata[13:].reshape(4, 7)
    for leg, foot in zip(("front_left", "front_right", "rear_left", "rear_right"), feet, strict=True):
        frame = model.getFrameId(leg)
        moving = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
        np.testing.assert_allclose(data.oMf[frame].translation, foot[:3], atol=1e-9)
        np.testing.assert_allclose(moving, foot[3:6], atol=1e-9)


def test_a_gait_begins_at_the_stand_and_never_jumps():
    gait = Gait.draw(np.random.default_rng(1))
    np.testing.assert_allclose(gait.targets(0.0), STAND)
    assert 0.0 < np.abs(gait.targets(2.0 + DT) - gait.targets(2.0)).max() < 0.1
