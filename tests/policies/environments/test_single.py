"""The Gymnasium environment of one robot."""

import subprocess
import sys

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from policies.environments.pictures import Camera
from policies.environments.registry import environment_ids
from policies.training.recipe import find_recipe, load_recipe
from robots.errors import ConfigError
from support.arm6 import SPEC
from support.environments import VARIOUS
from support.paths import ROOT
from support.planar import PLANAR3

ID = "firstshift/arm6-reach-position{}-v0"
KINDS = ["", "-goal"]
N = SPEC.n


def actions(count, size):
    return np.random.default_rng(0).uniform(-1.0, 1.0, (count, size)).astype(np.float32)


def numbers(observation):
    """All numbers of an observation, one after another."""
    return np.concatenate(list(observation.values())) if isinstance(observation, dict) else observation


def trajectory(env, seed, count=30):
    """Observations and rewards of random actions after a seeded reset."""
    seen = [numbers(env.reset(seed=seed)[0])]
    rewards = []
    for action in actions(count, size=env.action_space.shape[0]):
        observation, reward, *_ = env.step(action)
        seen.append(numbers(observation))
        rewards.append(reward)
    return np.array(seen), np.array(rewards)


@pytest.fixture
def opengl():
    try:
        Camera(SPEC, "test").close()
    except ConfigError as e:
        pytest.skip(str(e))


@pytest.mark.slow
@pytest.mark.parametrize("name", environment_ids())
def test_check_env_finds_nothing(name, opengl):
    with gymnasium.make(name) as env:
        check_env(env.unwrapped)  # warnings are errors here


@pytest.mark.parametrize("name", VARIOUS)
def test_equal_seeds_make_equal_trajectories(name):
    with gymnasium.make(name) as env, gymnasium.make(name) as other:
        (seen, rewards), second = trajectory(env, 4), trajectory(env, 4)
        np.testing.assert_array_equal(second[0], seen)
        np.testing.assert_array_equal(second[1], rewards)
        np.testing.assert_array_equal(trajectory(other, 4)[0], seen)
        assert np.abs(trajectory(env, 5)[0] - seen).max() > 0.01
        assert np.abs(np.diff(seen, axis=0)).max() > 0.005


@pytest.mark.parametrize("name", VARIOUS)
def test_next_episode_of_the_same_robot_differs(name):
    with gymnasium.make(name) as env:
        first = numbers(env.reset(seed=2)[0])
        draw = env.unwrapped.session.episodes.robot.draw
        second = numbers(env.reset()[0])
        assert env.unwrapped.session.episodes.robot.draw is draw
        assert np.abs(second - first).max() > 0.02
        np.testing.assert_array_equal(numbers(env.reset(seed=2)[0]), first)
        np.testing.assert_array_equal(numbers(env.reset()[0]), second)


def test_next_episode_of_an_arm_starts_at_another_pose():
    with gymnasium.make(ID.format("")) as env:
        first, second = env.reset(seed=2)[0], env.reset()[0]
        assert np.abs(second - first)[:N].max() > 0.02


@pytest.mark.parametrize("kind", KINDS)
def test_unseeded_robots_differ(kind):
    with gymnasium.make(ID.format(kind)) as env, gymnasium.make(ID.format(kind)) as other:
        assert (numbers(env.reset()[0]) != numbers(other.reset()[0])).any()


def test_episode_is_cut_when_its_goal_is_over():
    with gymnasium.make(ID.format("-goal")) as env:
        before, _ = env.reset(seed=1)
        ends = []
        for action in np.zeros((200, N), np.float32):
            after, _, terminated, truncated, _ = env.step(action)
            ends.append((terminated, truncated))
        assert ends == [(False, False)] * 199 + [(False, True)]
        np.testing.assert_array_equal(after["desired_goal"], before["desired_goal"])
        with pytest.raises(ResetNeeded):
            env.step(action)
        assert (env.reset()[0]["desired_goal"] != before["desired_goal"]).any()


def test_joint_out_of_range_terminates():
    with gymnasium.make(ID.format("")) as env:
        env.reset(seed=1)
        robot = env.unwrapped.session.episodes.robot
        beyond = robot.truth().q.copy()
        beyond[0, 0] = SPEC.joint_array("q_max")[0] + 0.1
        robot.plant.kinematics.place(np.array([0]), beyond)
        _, reward, terminated, truncated, info = env.step(np.zeros(N, np.float32))
        assert (terminated, truncated) == (True, False)
        assert info["joint_limit"] == -1.0
        assert reward < -1.0


def test_a_simulation_that_diverged_terminates_even_with_the_last_step():
    with gymnasium.make(ID.format("")) as env:
        env.reset(seed=1)
        session = env.unwrapped.session
        session.max_steps = 1
        session.episodes.robot.plant.valid[:] = False
        _, _, terminated, truncated, _ = env.step(np.zeros(N, np.float32))
        assert (terminated, truncated) == (True, False)


def test_episodes_begin_anywhere_in_the_start_range_of_the_recipe():
    share = load_recipe(find_recipe("planar3_velocity")).environment.start_range
    end, poses = share * PLANAR3.joint_array("q_max"), []
    with gymnasium.make("firstshift/planar3-planar_reach-velocity-v0") as env:
        env.reset(seed=1)
        for _ in range(20):
            env.reset()
            poses.append(env.unwrapped.session.episodes.robot.truth().q[0].copy())
    poses = np.array(poses)
    assert (np.abs(poses) <= end + 0.01).all()
    assert (np.abs(poses).max(axis=0) > 0.6 * end).all()


@pytest.mark.parametrize("name", ["arm6-reach-position", "planar3-planar_reach-velocity"])
def test_an_episode_begins_with_its_own_goal_in_view(name):
    with gymnasium.make(f"firstshift/{name}-v0") as env:
        for seed in (1, None, None, 2):
            env.reset(seed=seed)
            task = env.unwrapped.session.episodes.task
            for action in np.zeros((8, *env.action_space.shape), np.float32):
                # noise, bias and resolution of the camera
                np.testing.assert_allclose(task.camera_goal, task.goal, rtol=0, atol=0.01)
                env.step(action)


def test_step_before_reset_is_refused():
    env = gymnasium.make(ID.format("")).unwrapped
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(N, np.float32))


def test_action_of_another_size_is_refused():
    env = gymnasium.make(ID.format("")).unwrapped
    env.reset(seed=1)
    with pytest.raises(ConfigError, match=r"action: found shape \(1, 5\), expected \(1, 6\)"):
        env.step(np.zeros(5, np.float32))


def test_reset_options_are_refused():
    with (
        gymnasium.make(ID.format("")) as env,
        pytest.raises(ConfigError, match=r"reset: options: found pose, expected none"),
    ):
        env.reset(options={"pose": 1})


def test_window_without_display_is_bad_input(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match="render_mode 'human': found neither DISPLAY nor WAYLAND_DISPLAY"):
        gymnasium.make(ID.format(""), render_mode="human")


def test_images_show_robot_and_goal(opengl):
    with gymnasium.make(ID.format("-goal"), render_mode="rgb_array") as env:
        env.reset(seed=5)
        before = env.render()
        assert (before.dtype, before.ndim) == (np.uint8, 3)
        for action in np.ones((20, N), np.float32):
            env.step(action)
        after = env.render()
        assert np.abs(after.astype(float) - before).max() > 50
        env.unwrapped.session.episodes.task.goal[:] = [0.3, 0.3, 2.5]  # out of the picture
        greenness = after[:, :, 1].astype(float) - after[:, :, 0]
        gone = env.render()
        assert greenness.max() > 60 > (gone[:, :, 1].astype(float) - gone[:, :, 0]).max()


FIRST_PICTURES_THEN_TORCH = """
import gymnasium
import policies.environments.registry
env = gymnasium.make("firstshift/arm6-reach-position-v0", render_mode="rgb_array")
env.reset(seed=1)
env.render()
import torch._dynamo
env.render()
print("alive")
"""


@pytest.mark.slow
def test_torch_survives_pictures_that_came_first(opengl):
    pytest.importorskip("torch")
    command = [sys.executable, "-c", FIRST_PICTURES_THEN_TORCH]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, done.stdout) == (0, "alive\n"), done.stderr
