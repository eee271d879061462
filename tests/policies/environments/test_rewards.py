import numpy as np
import pytest

from policies.environments.rewards import Limits, Step, reward_terms, shaping
from policies.training.recipe import find_recipe, load_recipe
from robots.spec import load_robot
from support.arm6 import SPEC
from support.planar import arm_with_wheel

RECIPE = load_recipe(find_recipe("arm"))
N = SPEC.n


def step_of(**changes):
    rest = np.zeros((1, N))
    fields = {
        "q": SPEC.joint_array("q_home")[None],
        "qd": rest,
        "tau": rest,
        "qdd_change": rest,
        "dt": 0.02,
        "distance": np.array([0.5]),
        "reached": np.array([False]),
        "near": np.array([False]),
        "q_target": SPEC.joint_array("q_home")[None],
        "action_change": rest,
        "action_excess": rest,
        "manipulability": np.array([0.08]),
        "running": np.array([True]),
        "stopped": np.array([False]),
    }
    return Step(**{**fields, **changes})


def at(joint, value):
    q = SPEC.joint_array("q_home").copy()
    q[joint] = value
    return q[None]


LIMITS = Limits(SPEC, RECIPE.reward.near_share)
BEYOND = SPEC.joint_array("q_max")[0] + 0.01
REWARDS = {
    "survival": ({}, 0.001),
    "success": ({"reached": np.array([True])}, 1.001),
    "near a limit": ({"q": at(0, 0.95 * SPEC.joint_array("q_max")[0])}, 0.001 - 0.1),
    "beyond a limit": ({"q": at(0, BEYOND)}, 0.001 - 0.1 - 1.0),
    "power": ({"tau": np.full((1, N), 10.0), "qd": np.full((1, N), -2.0)}, 0.001 - 1e-4 * 20 * N),
    "jerk": ({"qdd_change": at(0, 0.0) * 0 + np.eye(N)[:1] * 2.0}, 0.001 - 1e-5 * 100),
}


@pytest.mark.parametrize(("changes", "expected"), REWARDS.values(), ids=REWARDS)
def test_reward_follows_the_recipe(changes, expected):
    step = step_of(**changes)
    np.testing.assert_allclose(reward_terms(step, LIMITS, RECIPE.reward).total, [expected], rtol=1e-12)
    assert LIMITS.broken(step.q).tolist() == ["q" in changes and changes["q"][0, 0] == BEYOND]


def test_a_wheel_has_no_limits_and_starts_anywhere_in_a_turn(tmp_path):
    spec = load_robot(arm_with_wheel(tmp_path))
    limits, home = Limits(spec, 0.9), spec.joint_array("q_home")
    turned = home + np.array([0.0, 0.0, 0.0, 40.0])
    assert not limits.broken(turned[None])[0]
    assert not limits.near(turned[None]).any()
    drawn = limits.draw(np.random.default_rng(0), 1.0, 2000)
    assert np.pi - 0.05 < np.abs(drawn[:, -1]).max() <= np.pi
    assert not limits.broken(drawn).any()


def test_shaping_grows_towards_the_goal_and_is_lost_at_a_stop():
    nearer = [
        shaping(step_of(distance=np.array([d])), LIMITS, RECIPE.shaping)[0] for d in (0.8, 0.2, 0.02, 0.0)
    ]
    assert nearer == sorted(nearer)
    stopped = step_of(distance=np.array([0.0]), running=np.array([False]), stopped=np.array([True]))
    assert shaping(stopped, LIMITS, RECIPE.shaping)[0] == RECIPE.shaping.stop
    asked = shaping(step_of(q_target=at(0, BEYOND)), LIMITS, RECIPE.shaping)
    assert asked[0] < shaping(step_of(), LIMITS, RECIPE.shaping)[0]
    singular = shaping(step_of(manipulability=np.array([0.002])), LIMITS, RECIPE.shaping)
    assert singular[0] == pytest.approx(
        shaping(step_of(), LIMITS, RECIPE.shaping)[0] + 0.75 * RECIPE.shaping.singular
    )
    shouted = shaping(step_of(action_excess=np.full((1, N), -2.0)), LIMITS, RECIPE.shaping)
    assert shouted[0] == pytest.approx(
        shaping(step_of(), LIMITS, RECIPE.shaping)[0] + 4 * N * RECIPE.shaping.action_excess
    )
