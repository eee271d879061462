"""Soft start: stiffness after arming, and what it is for."""

import numpy as np
import pytest

from deploy.motion.soft_start import FIRST_SHARE, RISE_S, soft_start
from deploy.state import DriveMode
from robots.models.nominal_model import torque_max
from robots.motors.drive_gains import drive_gains
from support.arm6 import SPEC
from support.runtimes import built, every, heard

RISE = round(RISE_S / SPEC.dt)


def test_stiffness_rises_and_damping_does_not():
    ticks = np.array([0, RISE // 2, RISE, 10 * RISE])
    drive = DriveMode(np.zeros(4, dtype=np.int64), np.full((4, 2), 8.0), np.full((4, 2), 3.0))
    own = np.array([8.0, 4.0])  # what a contract makes stiffer rises in the same time
    soft = soft_start(drive, own, ticks, SPEC.dt)
    rising = [8.0 * FIRST_SHARE, 4.0 * (1.0 + FIRST_SHARE), 8.0, 8.0]
    np.testing.assert_allclose(soft.kp, np.column_stack((rising, rising)))
    assert soft.kd is drive.kd
    assert soft_start(drive, own, ticks[2:].repeat(2), SPEC.dt) is drive


def test_drives_that_a_contract_makes_softer_rise_as_fast_as_the_robots_own():
    """A quarter of half of their own stiffness would let them sag twice as far."""
    drive = DriveMode(np.zeros(3, dtype=np.int64), np.full((3, 2), [5.0, 0.0]), np.full((3, 2), 3.0))
    soft = soft_start(drive, np.array([10.0, 10.0]), np.array([0, RISE // 2, RISE - 1]), SPEC.dt)
    np.testing.assert_allclose(soft.kp[:, 0], [10.0 * FIRST_SHARE, 5.0, 5.0])
    np.testing.assert_array_equal(soft.kp[:, 1], 0.0)  # of a drive that holds no angle


def test_an_armed_robot_becomes_stiff_once():
    pytest.importorskip("mujoco")
    runtime, stiffness = built(2), []
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    for _ in range(RISE + 20):
        runtime.tick()
        stiffness.append(runtime.command.drive.kp[0] / drive_gains(SPEC).kp)
    np.testing.assert_allclose(stiffness[0], FIRST_SHARE)
    assert (np.diff(stiffness, axis=0) >= 0.0).all()
    np.testing.assert_array_equal(stiffness[RISE], 1.0)


def test_an_encoder_that_is_wrong_is_no_blow_when_the_arm_gets_power():
    """2.4 mrad, about the most that bias and wear of draws.toml add up to: half of the range with all the stiffness."""
    pytest.importorskip("mujoco")
    runtime = built(2)
    wear, off = runtime.robot.plant.wear, 2.4e-3
    wear.encoder_rad[:] = [[-off], [off]]
    heard(runtime)
    before = np.abs(runtime.robot.truth().tau) / torque_max(SPEC)
    assert not runtime.arm(every(runtime)).any()
    most = before.copy()
    for _ in range(10):  # before the policy moves it
        runtime.tick()
        most = np.maximum(most, np.abs(runtime.robot.truth().tau) / torque_max(SPEC))
    assert (most - before).max() < 0.2
