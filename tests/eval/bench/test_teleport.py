"""A policy that teleports: the limits that each kind of drive keeps."""

import numpy as np
import pytest

from eval.bench.teleport import CAP, VARIANTS
from robots.models.nominal_model import torque_max
from robots.spec import load_robot

PLANAR = load_robot("planar3")


@pytest.fixture(scope="module")
def motions():
    return {name: variant(PLANAR) for name, variant in VARIANTS.items()}


def test_the_policy_asks_for_the_same_but_where_it_is_capped(motions):
    for name, motion in motions.items():
        steps = np.abs(np.diff(motion.target)).max()
        assert steps == pytest.approx(CAP) if "capped" in name else steps > 1.5


@pytest.mark.parametrize(
    ("name", "too_fast", "saturates"),
    [
        ("motor without limits", True, True),
        ("real motor", True, True),
        ("real motor, target capped", False, True),
        ("firstshift's runtime", False, False),
    ],
)
def test_limits_of_speed_and_torque(motions, name, too_fast, saturates):
    motion, joint = motions[name], PLANAR.joints[0]
    assert (np.abs(motion.qd).max() > joint.qd_max) == too_fast
    assert (np.abs(motion.tau).max() > 0.999 * torque_max(PLANAR)[0]) == saturates
