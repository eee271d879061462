"""Falls in an attack: what a robot does after its fall does not count, but for how the fall is noticed."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from deploy.truth import BaseTruth
from eval.attack.adversaries import ADVERSARIES
from eval.attack.arena import Arena, Setting
from eval.attack.candidate import Block
from eval.attack.falls import OF_FALLS, Falls
from eval.shard.job import WIDTH
from robots.models.nominal_model import imu_in_base, load_pinocchio
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC
from support.quadruped import QUADRUPED

SEED = 7


@pytest.mark.slow
def test_only_how_a_fall_is_noticed_counts_after_it():
    arena = Arena(Setting(robot=QUADRUPED.folder, mode=ControlMode.POSITION), SEED)
    push = ADVERSARIES["push"].first(QUADRUPED.n)
    still = {**push, "reach": (0.02,) * QUADRUPED.n, "follow": (0.0,)}
    half = WIDTH // 2
    outcome = arena.try_block(Block("push", (push,) * half + (still,) * half, SEED))
    judged = arena._shard.judge.counts()
    whole = {m.name: judged.worst[:, judged.columns(m.name)].max(axis=1) for m in judged.monitors}
    fell, stood = np.maximum(whole["tilt"], whole["base_height"]) > 1.0, judged.latches == 0
    assert fell.any()
    assert stood[half:].any()
    for name, ratios in outcome.worst.items():
        assert (ratios <= whole[name]).all()
        np.testing.assert_array_equal(ratios[stood], whole[name][stood])
        if name in OF_FALLS:
            np.testing.assert_array_equal(ratios, whole[name])
    assert (outcome.worst["base_height"][fell] < whole["base_height"][fell]).all()
    assert (outcome.worst["powered_fallen"] <= 1.0).all()


def truth(*, height=0.28, roll=0.0):
    """Truth of two robots, the first with its IMU at a height; the second stands."""
    quat_wxyz = np.array([[np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    imu = imu_in_base(QUADRUPED, load_pinocchio(QUADRUPED)[0])
    lower = np.sin(roll) * imu[1] + np.cos(roll) * imu[2]
    base = BaseTruth(
        position=np.array([[0.0, 0.0, height - lower], [0.0, 0.0, 0.28]]),
        quat_wxyz=quat_wxyz,
        velocity=np.zeros((2, 3)),
        angular_velocity=np.zeros((2, 3)),
        up=np.tile([0.0, 0.0, 1.0], (2, 1)),
    )
    return SimpleNamespace(base=base)


@pytest.mark.parametrize(
    ("change", "falls"),
    [
        ({}, False),
        ({"roll": QUADRUPED.base.tilt_max_rad - 1e-6}, False),
        ({"roll": QUADRUPED.base.tilt_max_rad + 1e-6}, True),
        ({"height": QUADRUPED.base.height_min_m + 1e-6}, False),
        ({"height": QUADRUPED.base.height_min_m - 1e-6}, True),
    ],
)
def test_a_robot_that_tilts_too_far_or_is_too_low_has_fallen(change, falls):
    found, powered = Falls(QUADRUPED, 2), np.ones(2, dtype=bool)
    assert found.step(truth(), powered).tolist() == [False, False]
    assert found.step(truth(**change), powered).tolist() == [falls, False]
    assert found.step(truth(**change), powered).tolist() == [False, False]  # it fell before
    assert found.fallen.tolist() == [falls, False]


def test_a_robot_whose_drives_end_has_fallen():
    found, off = Falls(QUADRUPED, 2), np.zeros(2, dtype=bool)
    assert not found.step(truth(), off).any()  # not armed yet
    assert not found.step(truth(), np.ones(2, dtype=bool)).any()
    assert found.step(truth(), np.array([False, True])).tolist() == [True, False]


def test_a_robot_on_a_mount_does_not_fall():
    arena = Arena(Setting(robot=SPEC.folder, mode=ControlMode.POSITION), SEED)
    arena._shard.tick()
    falls = Falls(SPEC, WIDTH)
    for powered in (True, False):
        assert not falls.step(arena._shard.truth, np.full(WIDTH, powered)).any()
    assert not falls.fallen.any()
