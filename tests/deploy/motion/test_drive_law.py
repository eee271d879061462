from types import SimpleNamespace

import numpy as np
import pytest

from deploy.motion.drive_law import CompliantDrives, SpringDrives, StiffDrives, drive_law
from deploy.state import STOP_MOMENTS
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.motors.gains import Gains
from robots.spec import load_robot
from support.arm6 import SPEC

POINTS = STOP_MOMENTS + 2
"""Points of a plan: a setpoint, the moments of its stop, and its end."""


@pytest.mark.parametrize("mode", ControlMode)
def test_setpoints_may_need_the_share_of_torque_of_their_mode(mode):
    own = SPEC.margins.torque_mode.model_copy(update={"tau": 0.7})
    spec = SPEC.model_copy(update={"margins": SPEC.margins.model_copy(update={"torque_mode": own})})
    law = drive_law(spec, mode, None, Fleet(spec, 2))
    share = 0.7 if mode is ControlMode.TORQUE else SPEC.margins.tau
    np.testing.assert_array_equal(law.torque_limit, share * torque_max(SPEC))


def test_drives_of_a_floating_base_give_way():
    walker = load_robot("quadruped")
    fleet, gains = Fleet(walker, 2), Gains(np.full(walker.n, 30.0), np.full(walker.n, 1.0))
    assert type(drive_law(walker, ControlMode.POSITION, None, fleet)) is CompliantDrives
    assert type(drive_law(walker, ControlMode.POSITION, gains, fleet)) is SpringDrives
    assert type(drive_law(SPEC, ControlMode.POSITION, None, Fleet(SPEC, 2))) is StiffDrives


def test_compliant_drives_are_expected_where_they_are_sent_and_as_far_from_there_as_now():
    walker, rng = load_robot("quadruped"), np.random.default_rng(3)
    law = drive_law(walker, ControlMode.POSITION, None, Fleet(walker, 2))
    sent, q = rng.normal(size=(POINTS, 3, walker.n)), rng.normal(size=(3, walker.n))
    poses = law.expected_poses(SimpleNamespace(q=q), sent.reshape(-1, walker.n)).reshape(2, POINTS, 3, -1)
    np.testing.assert_array_equal(poses[0], sent)
    np.testing.assert_allclose(poses[1] - sent, np.broadcast_to(q - sent[0], sent.shape), atol=1e-15)
    assert law.expectations == len(poses)


def test_only_compliant_drives_limit_the_torques_that_are_sent():
    walker = load_robot("quadruped")
    for spec, most in ((walker, walker.margins.tau * torque_max(walker)), (SPEC, 2.0 * torque_max(SPEC))):
        law, asked = drive_law(spec, ControlMode.POSITION, None, Fleet(spec, 2)), 2.0 * torque_max(spec)[None]
        np.testing.assert_array_equal(law.limited(asked), most[None])
        np.testing.assert_array_equal(law.limited(-asked), -most[None])
        np.testing.assert_array_equal(law.limited(0.1 * asked), 0.1 * asked)


def test_drives_of_a_floating_base_saturate_inside_their_range():
    walker = load_robot("quadruped")
    fleet, gains = Fleet(walker, 2), Gains(np.full(walker.n, 30.0), np.full(walker.n, 1.0))
    laws = [drive_law(walker, ControlMode.POSITION, each, fleet) for each in (None, gains)]
    assert [law.current_share for law in laws] == [walker.margins.tau] * 2
    assert drive_law(SPEC, ControlMode.POSITION, None, Fleet(SPEC, 2)).current_share == 1.0
    state, zero = (
        SimpleNamespace(q=np.zeros((1, walker.n)), qd=np.zeros((1, walker.n))),
        np.zeros((1, walker.n)),
    )
    most = walker.margins.tau * torque_max(walker)[None]
    assert most.max() < 30.0
    for toward in (-1.0, 1.0):
        np.testing.assert_array_equal(laws[1].torque(state, zero + toward, zero, zero), toward * most)
