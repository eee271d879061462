"""Variance of filters whose joints nobody led for some slots."""

import numpy as np
import pytest

from deploy.estimation.joint_filter import JointFilter
from deploy.estimation.late_ticks import CATCH_UP_S, LateTicks
from support.arm6 import SPEC

N, DT, SLOTS = SPEC.n, SPEC.dt, 10


def test_variance_grows_by_the_way_skipped_and_by_the_speed_to_catch_up():
    joints, late, qd = JointFilter(SPEC, 3), LateTicks(SPEC, 3), np.tile(np.linspace(-2.0, 2.0, N), (3, 1))
    late.skip(np.array([0, SLOTS, 0]), qd, joints)
    np.testing.assert_allclose(joints.p00[1], (qd[1] * SLOTS * DT) ** 2)
    for _ in range(2 * round(CATCH_UP_S / DT)):
        late.step(joints)
    np.testing.assert_allclose(joints.p11[1], qd[1] ** 2)
    others = [0, 2]
    assert not joints.p00[others].any()
    assert not joints.p11[others].any()


def test_a_late_tick_while_joints_catch_up_begins_anew():
    joints, late, qd = JointFilter(SPEC, 1), LateTicks(SPEC, 1), np.ones((1, N))
    late.skip(np.array([SLOTS]), qd, joints)
    for _ in range(5):
        late.step(joints)
    late.skip(np.array([SLOTS]), 2.0 * qd, joints)
    np.testing.assert_allclose(joints.p00, (1.0 + 4.0) * (SLOTS * DT) ** 2)
    for _ in range(2 * round(CATCH_UP_S / DT)):
        late.step(joints)
    np.testing.assert_allclose(joints.p11, 5 * DT / CATCH_UP_S + 4.0)


def test_a_saved_catching_up_goes_on():
    joints, one, other = JointFilter(SPEC, 1), LateTicks(SPEC, 1), LateTicks(SPEC, 1)
    one.skip(np.array([SLOTS]), np.ones((1, N)), joints)
    other.restore(one.save())
    other.step(joints)
    assert joints.p11[0, 0] == pytest.approx(DT / CATCH_UP_S)
