"""Actions that follow from a recipe's promise."""

import numpy as np
import pytest

from policies.training.recipe import Promise, contract_of, find_recipe, load_recipe
from robots.errors import ConfigError
from robots.models.nominal_model import torque_max
from robots.strict import parse
from support.arm6 import SPEC

RECIPE = load_recipe(find_recipe("arm"))
LOW, HIGH = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
NO_TARGET = ("joint_position", "joint_velocity", "last_action")


def recipe(observation=NO_TARGET, **promise):
    changed = Promise(policy_hz=50, reach_m=0.85, **promise)
    return RECIPE.model_copy(update={"promise": changed, "observation": observation})


FULL = {
    "position": (HIGH - LOW) / 4,
    "velocity": SPEC.joint_array("qd_max") / 2,
    "torque": torque_max(SPEC) / 2,
}


@pytest.mark.parametrize("mode", FULL)
def test_full_action_is_a_share_of_the_limit(mode):
    action = contract_of(recipe(mode=mode, share=0.5), SPEC, {}).action
    assert (action.mode, action.clip, action.leash_rad) == (mode, (-1.0, 1.0), None)
    np.testing.assert_allclose(action.scale, FULL[mode], rtol=1e-12)
    offset = (LOW + HIGH) / 2 if mode == "position" else None
    assert action.offset == (None if offset is None else tuple(offset))


WRONG = {
    "share of increments": (
        {"share": 0.5, "increment_rad": 0.1, "leash_rad": 0.3},
        "share: found 0.5 in mode",
    ),
    "no leash": ({"increment_rad": 0.1}, "leash_rad: missing in mode 'position_increment'"),
    "leash of a speed": (
        {"mode": "velocity", "share": 1.0, "leash_rad": 0.3},
        "leash_rad: found 0.3 in mode 'vel",
    ),
    "no share": ({"mode": "torque"}, "share: missing in mode 'torque'"),
}


@pytest.mark.parametrize(("promise", "message"), WRONG.values(), ids=WRONG)
def test_fields_of_another_mode_are_refused(promise, message):
    with pytest.raises(ConfigError, match=f"x.toml: promise.{message}"):
        parse({"policy_hz": 50, "reach_m": 0.85, **promise}, Promise, source="x.toml")


def test_offset_of_a_target_that_is_no_angle_is_refused():
    with pytest.raises(ConfigError, match="target_offset"):
        contract_of(recipe(("joint_position", "target_offset"), mode="velocity", share=1.0), SPEC, {})
