import numpy as np
import pytest

pytest.importorskip("rsl_rl")

from policies.first_episodes import (
    ACTION_CHANGE,
    EPISODES,
    RECIPES,
    ROBOTS,
    STEPS,
    act_randomly,
    final_distances,
    small_recipe,
)
from policies.training.recipe import find_recipe, load_recipe


@pytest.mark.parametrize("name", RECIPES)
def test_four_robots_have_a_hundred_episodes_each(name):
    small = small_recipe(load_recipe(find_recipe(name)), seed=3)
    assert (small.environment.robots, small.environment.goals_per_episode) == (ROBOTS, 1)
    assert small.learner.stages[0].iterations * STEPS == EPISODES * 200  # of 4 s at 50 Hz
    assert small.shaping.action_change == ACTION_CHANGE


@pytest.mark.slow
def test_each_robot_adds_a_distance_at_the_end_of_each_episode():
    small = small_recipe(load_recipe(find_recipe(RECIPES[0])), seed=3)
    found = final_distances(small, lambda env: act_randomly(env, 410, seed=1))
    assert 2 * ROBOTS <= len(found) <= 3 * ROBOTS  # the first episodes begin in the middle of a goal's time
    assert (found > 0.0).all()
    again = final_distances(small, lambda env: act_randomly(env, 410, seed=1))
    np.testing.assert_array_equal(found, again)
