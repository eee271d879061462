"""Rewards of goal environments for goals that were not pursued."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

import policies.environments.registry as _registered
from robots.errors import ConfigError
from support.arm6 import SPEC

ID = "firstshift/arm6-reach-position-goal-v0"
STEPS, ROBOTS = 210, 3

assert _registered


def transitions(goal=None):
    """Last achieved and desired goal, reward and info of every step of some robots under random actions.

    Args:
        goal: (B, 3) m in place of the goals that the seeds gave.
    """
    envs = gymnasium.make_vec(ID, num_envs=ROBOTS)
    envs.reset(seed=8)
    if goal is not None:
        envs.session.episodes.task.goal[:] = goal
    rng, rows = np.random.default_rng(1), []
    for _ in range(STEPS):
        session = envs.session
        rows.append(session.step(rng.uniform(-1.0, 1.0, (ROBOTS, SPEC.n))))
        if rows[-1].end.done.any():
            session.begin(rows[-1].end.done)
            session.observe()
    return envs, rows


@pytest.fixture(scope="module")
def pursued():
    return transitions()


def test_reward_of_the_step_is_the_reward_of_its_goal(pursued):
    envs, rows = pursued
    for row in rows:
        seen = row.observation
        again = envs.compute_reward(seen["achieved_goal"], seen["desired_goal"], row.info)
        np.testing.assert_array_equal(again, row.reward)
    assert np.ptp([row.reward for row in rows]) > 0


def test_batch_of_infos_and_single_transitions_agree(pursued):
    envs, rows = pursued
    env = gymnasium.make(ID).unwrapped
    achieved, desired = (
        np.concatenate([row.observation[f"{kind}_goal"] for row in rows]) for kind in ("achieved", "desired")
    )
    infos = [{name: v[k] for name, v in row.info.items()} for row in rows for k in range(ROBOTS)]
    expected = np.concatenate([row.reward for row in rows])
    np.testing.assert_array_equal(envs.compute_reward(achieved, desired, infos), expected)
    np.testing.assert_array_equal(envs.compute_reward(achieved, desired, np.array(infos)), expected)
    for k in range(0, len(infos), 50):
        single = env.compute_reward(achieved[k], desired[k], infos[k])
        assert isinstance(single, float)
        assert single == expected[k]


def test_relabelled_reward_is_that_of_having_pursued_the_other_goal(pursued):
    """Random actions do not look at the goal: with another one from the start the robots move the same."""
    envs, rows = pursued
    other = rows[90].observation["achieved_goal"] + 0.005
    _, really = transitions(other)
    episode = 200  # steps: then goals are new
    reached = 0
    for row, real in zip(rows[:episode], really[:episode], strict=True):
        np.testing.assert_array_equal(real.observation["desired_goal"], other)
        relabelled = envs.compute_reward(row.observation["achieved_goal"], other, row.info)
        np.testing.assert_array_equal(relabelled, real.reward)
        reached += int(real.info["is_success"].sum())
    assert reached > 5


def test_success_counts_by_ground_truth_and_only_while_running(pursued):
    envs, rows = pursued
    row = rows[60]
    achieved = row.observation["achieved_goal"]
    error = row.info["achieved_error"]
    tolerance = envs.session.episodes.task.criterion.tolerance
    assert np.abs(error).max() > 1e-5
    true = achieved + error
    sideways = np.array([1.0, 0.0, 0.0])
    for share, success in ((0.99, 1.0), (1.01, 0.0)):
        reward = envs.compute_reward(achieved, true + share * tolerance * sideways, row.info)
        for running in (False, True):
            info = {**row.info, "running": np.full(ROBOTS, running)}
            changed = envs.compute_reward(achieved, true + share * tolerance * sideways, info)
            rest = sum(row.info[name] for name in ("joint_limit", "near_limit", "power", "jerk", "survival"))
            np.testing.assert_allclose(changed, success * running + rest, rtol=1e-12)
        np.testing.assert_array_equal(changed, reward)


def test_success_does_not_end_an_episode():
    env = gymnasium.make(ID).unwrapped
    observation, _ = env.reset(seed=4)
    task = env.session.episodes.task
    task.goal[:] = observation["achieved_goal"]
    rows = [env.step(np.zeros(SPEC.n, np.float32)) for _ in range(20)]
    for _, reward, terminated, truncated, info in rows:
        assert (info["is_success"], terminated, truncated) == (info["running"], False, False)
        assert reward == pytest.approx(1.0 * info["running"], abs=0.02)
    assert rows[-1][-1]["running"]


def test_missing_info_is_refused():
    env = gymnasium.make(ID).unwrapped
    with pytest.raises(ConfigError, match=r"info: found no 'achieved_error', expected .*copy_info_dict=True"):
        env.compute_reward(np.zeros((2, 3)), np.zeros((2, 3)), [{}, {}])
