"""Extra loads of drawn robots."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.attack.loaded_robots import extra_load
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.spec import load_robot

ARM = load_robot("arm6")


def test_extra_load_is_torque_of_mass_payload_and_push_at_full_reach():
    plain = median_draw(load_distributions(ARM), ARM, 1).replaced(
        {"links.mass": 1.0, "payload.mass_kg": 0.0, "push.force_n": 0.0}
    )
    assert extra_load(ARM, plain) == pytest.approx(0.0)
    pushed = extra_load(ARM, plain.replaced({"push.force_n": 30.0}))
    assert pushed == pytest.approx(30.0 * 0.2393 / 28.0)  # wrist_1, 0.0997 + 0.0996 + 0.04 m from the tool
    carrying = extra_load(ARM, plain.replaced({"payload.mass_kg": 30.0 / 9.81}))
    np.testing.assert_allclose(carrying, pushed)
    heavy = extra_load(ARM, plain.replaced({"links.mass": 1.2}))
    assert 0.05 < heavy < 0.15
