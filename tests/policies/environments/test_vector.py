"""B robots in one process against B environments of one robot."""

from functools import partial

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

import policies.environments.registry as _registered
from policies.environments.vector import RobotVectorEnv
from robots.errors import ConfigError
from support.environments import VARIOUS

LENGTHS = (9, 14, 30)
"""Policy steps of an episode of each robot: they end at different times."""
ROBOTS, STEPS = len(LENGTHS), 32

assert _registered


def same(found, expected, agree=np.testing.assert_array_equal):
    """Assert equal bits of arrays, or of dictionaries of arrays."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for name in expected:
            same(found[name], expected[name], agree)
    else:
        agree(found, expected)


def close(found, expected):
    """Assert equality to rounding: bits are promised for equal widths only."""
    same(found, expected, partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-6))


def random_actions(envs):
    shape = (STEPS, *envs.action_space.shape)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def row_of(observation, row):
    return {k: v[row] for k, v in observation.items()} if isinstance(observation, dict) else observation[row]


@pytest.mark.parametrize("name", VARIOUS)
def test_robots_side_by_side_are_robots_alone(name):
    envs = gymnasium.make_vec(name, num_envs=ROBOTS)
    assert isinstance(envs.unwrapped, RobotVectorEnv)
    envs.session.max_steps = np.array(LENGTHS)
    alone = [gymnasium.make(name, max_episode_steps=length) for length in LENGTHS]
    seen, _ = envs.reset(seed=5)
    for row, env in enumerate(alone):
        close(row_of(seen, row), env.reset(seed=5 + row)[0])
    for action in random_actions(envs):
        seen, reward, terminated, truncated, info = envs.step(action)
        for row, env in enumerate(alone):
            last, *rest, about = env.step(action[row])
            assert [terminated[row], truncated[row]] == rest[1:]
            close(reward[row], rest[0])
            if truncated[row]:
                close(info["final_obs"][row], last)
                close(info["final_info"]["power"][row], about["power"])
                assert not info["_power"][row]
                last, _ = env.reset()
            else:
                close(info["power"][row], about["power"])
            close(row_of(seen, row), last)


@pytest.mark.parametrize("name", VARIOUS)
def test_equal_widths_and_seeds_give_equal_bits(name):
    def run(**options):
        envs = gymnasium.make_vec(name, num_envs=ROBOTS, max_episode_steps=8, **options)
        envs.reset(seed=1)
        return [envs.step(action)[:2] for action in random_actions(envs)]

    for (seen, reward), (other_seen, other_reward) in zip(run(), run(threads=2), strict=True):
        same(other_seen, seen)
        same(other_reward, reward)


@pytest.mark.parametrize("name", VARIOUS)
def test_seed_for_each_robot(name):
    envs = gymnasium.make_vec(name, num_envs=2)
    forwards, _ = envs.reset(seed=[3, 9])
    backwards, _ = envs.reset(seed=[9, 3])
    for row in range(2):
        close(row_of(forwards, row), row_of(backwards, 1 - row))
    with pytest.raises(ConfigError, match="reset: seed: found 3 seeds, expected 2"):
        envs.reset(seed=[1, 2, 3])


def test_images_of_every_robot():
    envs = gymnasium.make_vec(VARIOUS[0], num_envs=2, render_mode="rgb_array")
    envs.reset(seed=1)
    try:
        first, second = envs.render()
    except ConfigError as e:
        pytest.skip(str(e))
    assert np.abs(first.astype(float) - second).max() > 50
    envs.close()
