"""Drives of a stop that become stiff, robot by robot and joint by joint."""

import numpy as np

from deploy.motion.drive_modes import drive_modes
from deploy.motion.takeover import DAMPING_POWER, TAKEOVER_S, TAKEOVER_SHARE, Takeover
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.motors.gains import Gains
from support.arm6 import SPEC

N, ROBOTS = SPEC.n, 3
TICKS = round(TAKEOVER_S / SPEC.dt)
OWN = drive_gains(SPEC)
TORQUE = drive_modes(SPEC, ControlMode.TORQUE, None, ROBOTS)


def taking_over(drives=TORQUE):
    return Takeover(drives.policy, drives.stop, SPEC.dt)


def test_a_drive_without_a_policy_before_has_its_whole_stiffness():
    assert taking_over().drive is TORQUE.stop


def test_stiffness_and_damping_grow_by_the_same_factors_in_each_tick():
    takeover, none = taking_over(), np.zeros(ROBOTS, dtype=bool)
    takeover.commit(~none)
    for tick in range(TICKS + 3):
        share = TAKEOVER_SHARE ** max(0.0, 1.0 - tick / TICKS)
        assert takeover.held.tolist() == [min(tick, TICKS)] * ROBOTS
        np.testing.assert_allclose(takeover.drive.kp, np.tile(share * OWN.kp, (ROBOTS, 1)), rtol=1e-12)
        np.testing.assert_allclose(
            takeover.drive.kd, np.tile(share**DAMPING_POWER * OWN.kd, (ROBOTS, 1)), rtol=1e-12
        )
        assert (takeover.drive.mode == ControlMode.POSITION).all()
        np.testing.assert_allclose(takeover.first_drive.kp, np.tile(0.01 * OWN.kp, (ROBOTS, 1)), rtol=1e-12)
        takeover.commit(none)


def test_robots_take_over_on_their_own():
    takeover = taking_over()
    takeover.commit(np.array([True, False, True]))
    assert takeover.held.tolist() == [0, TICKS, 0]
    np.testing.assert_allclose(takeover.drive.kp[:, 0] / OWN.kp[0], [TAKEOVER_SHARE, 1.0, TAKEOVER_SHARE])
    takeover.end(np.array([True, False, False]))
    assert takeover.held.tolist() == [TICKS, TICKS, 0]


def test_joints_that_held_their_angle_stay_stiff():
    wheel = Gains(np.where(np.arange(N) == 5, 0.0, OWN.kp), OWN.kd)
    takeover = taking_over(drive_modes(SPEC, ControlMode.VELOCITY, wheel, ROBOTS))
    takeover.commit(np.ones(ROBOTS, dtype=bool))
    share = np.where(np.arange(N) == 5, TAKEOVER_SHARE, 1.0)
    np.testing.assert_allclose(takeover.drive.kp, np.tile(share * OWN.kp, (ROBOTS, 1)), rtol=1e-12)
    np.testing.assert_allclose(
        takeover.drive.kd, np.tile(share**DAMPING_POWER * OWN.kd, (ROBOTS, 1)), rtol=1e-12
    )
