"""Stable-Baselines3 on simulated robots."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")
sb3 = pytest.importorskip("stable_baselines3")

from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv

from policies.environments.registry import environment_ids
from policies.environments.stable_baselines import StableBaselinesEnv
from support.environments import VARIOUS

ID = "firstshift/arm6-reach-position{}-v0"
SMALL = {"net_arch": [16]}

pytestmark = pytest.mark.slow


def robots(name, count=2, **options):
    return StableBaselinesEnv(gymnasium.make_vec(name, num_envs=count, **options))


@pytest.mark.parametrize("name", environment_ids())
def test_check_env_finds_nothing(name):
    check_env(gymnasium.make(name).unwrapped)  # warnings are errors here


@pytest.mark.parametrize("name", VARIOUS)
def test_view_is_what_stable_baselines_makes_of_single_robots(name):
    length, count = 6, 2
    one = lambda: gymnasium.make(name, max_episode_steps=length)  # noqa: E731
    alone, together = DummyVecEnv([one] * count), robots(name, count, max_episode_steps=length)
    for envs in (alone, together):
        envs.seed(4)

    def same(found, expected):
        if isinstance(expected, dict):
            for part in expected:
                same(found[part], expected[part])
        else:
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)

    same(together.reset(), alone.reset())
    shape = (2 * length, count, *alone.action_space.shape)
    for action in np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32):
        mine, theirs = together.step(action), alone.step(action)
        for found, expected in zip(mine[:3], theirs[:3], strict=True):
            same(found, expected)
            assert getattr(found, "dtype", None) == getattr(expected, "dtype", None)
        for found, expected in zip(mine[3], theirs[3], strict=True):
            assert found.keys() == expected.keys()
            same(found, expected)
    assert theirs[2].all()


def test_ppo_runs():
    model = sb3.PPO(
        "MlpPolicy", robots(ID.format("")), n_steps=64, batch_size=32, policy_kwargs=SMALL, seed=0
    )
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(256)
    assert model.num_timesteps == 256
    assert all(np.isfinite(p.detach().numpy()).all() for p in model.policy.parameters())
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))


def test_sac_with_hindsight_runs_and_relabels_by_the_reward_of_the_step():
    envs, her = (
        robots(ID.format("-goal"), max_episode_steps=50),
        {"n_sampled_goal": 4, "copy_info_dict": True},
    )
    model = sb3.SAC(
        *("MultiInputPolicy", envs),
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs=her,
        learning_starts=150,
        batch_size=32,
        policy_kwargs=SMALL,
        seed=0,
    )
    model.learn(400)
    assert model.num_timesteps == 400
    buffer = model.replay_buffer
    batch = buffer.sample(2000)
    real = 400  # first; goals of the others are relabelled
    success = (batch.rewards > 0.5).numpy().ravel()
    achieved, desired = (batch.next_observations[f"{kind}_goal"].numpy() for kind in ("achieved", "desired"))
    distance = np.linalg.norm(achieved - desired, axis=1)
    tolerance = envs.env.session.episodes.task.criterion.tolerance
    # Positions are seen by the robot, rewards are true: some millimetres between them decide nothing here.
    assert not success[distance > tolerance + 0.005].any()
    assert success[:real].mean() < 0.05
    assert 0.1 < success[real:].mean() < 0.95
    np.testing.assert_array_equal(batch.dones.numpy(), 0)
