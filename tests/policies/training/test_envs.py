import numpy as np
import pytest

from support.arm6 import SPEC
from support.runtimes import Thinking

pytest.importorskip("torch")

import torch

from deploy.simulation import simulate
from deploy.state import Mode
from policies.training.envs import RuntimeEnv
from policies.training.recipe import contract_of, find_recipe, load_recipe
from policies.training.rewards import Limits, Step, reward, shaping
from robots.randomness import training_seed

pytestmark = pytest.mark.slow

RECIPE = load_recipe(find_recipe("arm"))
N = SPEC.n


def env_of(robots, seed=1):
    small = RECIPE.environment.model_copy(update={"robots": robots})
    return RuntimeEnv(RECIPE.model_copy(update={"environment": small, "seed": seed}), SPEC, threads=1)


class Learner(Thinking):
    """What a learner would do, as a policy: a fixed function of the observation."""

    def __init__(self, size):
        self.weights = np.random.default_rng(0).normal(size=(size, N)).astype(np.float32)

    def step(self, observation):
        return np.stack([np.tanh((row[:, None] * self.weights).sum(axis=0)) for row in observation])


def test_training_runs_the_shipped_tick():
    """A learner between the halves of the tick sends, bit for bit, what the runtime sends with it as its policy."""
    env, robots = env_of(3), 3
    seeds = [training_seed(1, robot) for robot in range(robots)]
    contract = contract_of(RECIPE, SPEC, {})
    learner = Learner(contract.observation_size)
    shipped, robot = simulate(SPEC, contract, seeds, learner)
    every = np.ones(robots, dtype=bool)
    q = env.runtime.robot.plant.q.copy()
    robot.reset(every, q)
    shipped.reset(every)
    shipped.task.restore(env.runtime.task.save())
    ticks = 0
    for _ in range(150):
        env.step(torch.from_numpy(learner.step(env.get_observations()["actor"].numpy())))
        while ticks < env.runtime.ticks:
            observation, off = shipped.sense(), ~shipped.supervisor.powered
            if observation is not None and off.any():  # as the environment does, until everybody is armed
                shipped.arm(off)
            shipped.act(None if observation is None else learner.step(observation))
            ticks += 1
        np.testing.assert_array_equal(shipped.command.q, env.runtime.command.q)
        np.testing.assert_array_equal(robot.truth().q, env.runtime.robot.truth().q)
    assert (shipped.supervisor.mode == Mode.RUNNING).any()
    assert np.abs(shipped.command.q - q).max() > 0.1


def test_episode_ends_with_its_goals_and_restarts_elsewhere():
    env = env_of(4)
    env.episode_length_buf[2] = env.max_episode_length - 1
    before = env.runtime.robot.truth().q.copy()
    _, _, done, extras = env.step(torch.zeros(4, N))
    assert done.tolist() == [0, 0, 1, 0]
    assert extras["time_outs"].tolist() == [0, 0, 1, 0]
    assert np.abs(env.runtime.robot.truth().q - before).max(axis=1)[2] > 0.05
    assert env.episode_length_buf.tolist() == [1, 1, 0, 1]
    for _ in range(10):
        env.step(torch.zeros(4, N))
    assert (env.runtime.supervisor.mode == Mode.RUNNING).all()


def test_actor_observes_no_ground_truth():
    env = env_of(2)
    observation = env.get_observations()
    assert observation["actor"].shape == (2, contract_of(RECIPE, SPEC, {}).observation_size)
    env.runtime.robot.plant.tool += 1.0
    after = env.get_observations()
    torch.testing.assert_close(after["actor"], observation["actor"], rtol=0, atol=0)
    assert (after["privileged"] != observation["privileged"]).any()


def test_nan_action_costs_a_stop_and_spreads_no_nan():
    env = env_of(3)
    actions = torch.zeros(3, N)
    actions[1, 2] = torch.nan
    for _ in range(8):  # arming first
        _, total, _, _ = env.step(actions)
        assert torch.isfinite(total).all()
    assert env.runtime.supervisor.stopping.tolist() == [False, True, False]


def test_goals_are_scored_at_their_end_or_at_a_violation():
    env = env_of(3)
    env.runtime.task.elapsed[:] = 0
    env.step(torch.zeros(3, N))
    assert env.due == 0
    last = round(env.runtime.task.criterion.period_s / SPEC.dt) - env.runtime.decimation
    env.runtime.task.elapsed[:] = [last, 0, 0]
    beyond = env.runtime.robot.truth().q.copy()
    beyond[1, 0] = SPEC.joint_array("q_max")[0] + 0.1
    env.runtime.robot.plant.kinematics.place(np.array([1]), beyond)
    env.step(torch.zeros(3, N))
    assert env.due == 2


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
    total, broken = reward(step_of(**changes), LIMITS, RECIPE.reward)
    np.testing.assert_allclose(total, [expected], rtol=1e-12)
    assert broken.tolist() == ["q" in changes and changes["q"][0, 0] == BEYOND]


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
