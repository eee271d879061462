import numpy as np
import pytest

from deploy.motion.drive_law import drive_law
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC

MARGINS = SPEC.margins


@pytest.mark.parametrize("mode", ControlMode)
def test_setpoints_may_need_the_share_of_torque_of_their_mode(mode):
    law = drive_law(SPEC, mode, None, Fleet(SPEC, 2))
    np.testing.assert_array_equal(law.torque_limit, MARGINS.of(mode).tau * torque_max(SPEC))


def test_velocity_mode_leaves_more_torque_than_position_mode():
    """Or the test above would prove nothing."""
    assert MARGINS.of(ControlMode.VELOCITY).tau < MARGINS.tau
