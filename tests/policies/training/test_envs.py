import numpy as np
import pytest

from support.arm6 import SPEC
from support.planar import PLANAR3, joint_angles
from support.runtimes import Thinking

pytest.importorskip("torch")

import torch

from deploy.reasons import Reason
from deploy.simulation import simulate
from deploy.state import Mode
from policies.training.envs import RuntimeEnv
from policies.training.recipe import Promise, contract_of, find_recipe, load_recipe
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


def test_a_simulation_that_diverged_with_its_last_step_is_no_time_out():
    env = env_of(2)
    env.episode_length_buf[:] = env.max_episode_length - 1
    env.runtime.robot.plant.valid[1] = False
    _, _, done, extras = env.step(torch.zeros(2, N))
    assert done.tolist() == [1, 1]
    assert extras["time_outs"].tolist() == [1, 0]


def test_actor_observes_no_ground_truth():
    env = env_of(2)
    observation = env.get_observations()
    assert observation["actor"].shape == (2, contract_of(RECIPE, SPEC, {}).observation_size)
    env.runtime.robot.plant.tool += 1.0
    after = env.get_observations()
    torch.testing.assert_close(after["actor"], observation["actor"], rtol=0, atol=0)
    assert (after["privileged"] != observation["privileged"]).any()


def test_peaks_are_the_largest_true_speeds_of_every_tick():
    env, speeds = env_of(2), []
    robot = env.episodes.robot
    write = robot.write

    def watched(command):
        write(command)
        speeds.append(np.abs(robot.truth().qd))

    robot.write = watched
    rng = np.random.default_rng(0)
    for _ in range(20):
        env.step(torch.from_numpy(rng.uniform(-1, 1, (2, N))))
    assert len(speeds) == 20 * env.runtime.decimation
    assert np.max(speeds) > 0.1
    np.testing.assert_array_equal(env.episodes.peak_qd, np.max(speeds, axis=0))


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


def test_success_of_core_goals_is_logged_apart():
    """Of a policy that reaches goals with a positive height only; an arm's task logs nothing of the kind."""
    small = RECIPE.environment.model_copy(update={"robots": 16})
    promise = Promise(mode="position", policy_hz=50, share=1.0, reach_m=0.9)
    planar = {"robot": "planar3", "task": "planar_reach", "environment": small, "promise": promise}
    env = RuntimeEnv(RECIPE.model_copy(update=planar), PLANAR3, threads=1)
    core, shares = env.runtime.task.criterion.core, []
    for _ in range(500):
        goal = env.runtime.task.goal.copy()
        wanted = np.where(goal[:, 2:] > 0.0, joint_angles(goal), 0.0)
        _, _, _, extras = env.step(torch.from_numpy(wanted / (np.pi / 2)))
        due = env.runtime.task.ended
        if due.any() and core.contains(goal[due]).any():
            expected = (goal[due, 2] > 0.0)[core.contains(goal[due])].mean()
            shares.append((extras["log"]["Task/success_core"], expected))
        else:
            assert "Task/success_core" not in extras["log"]
    found, expected = np.array(shares).T
    assert len(found) > 20
    assert np.abs(found - expected).mean() < 0.1
    assert 0.2 < found.mean() < 0.8


def test_episodes_begin_anywhere_in_the_start_range():
    recipe = load_recipe(find_recipe("planar3_velocity"))
    share, robots = recipe.environment.start_range, 64
    small = recipe.environment.model_copy(update={"robots": robots})
    env = RuntimeEnv(recipe.model_copy(update={"environment": small}), PLANAR3, threads=1)
    q, end = env.runtime.robot.truth().q, share * PLANAR3.joint_array("q_max")
    assert (np.abs(q) <= end + 0.01).all()
    assert (np.abs(q).max(axis=0) > 0.8 * end).all()
    assert (np.abs(q.mean(axis=0)) < 0.25 * end).all()  # over three standard deviations of the mean


@pytest.mark.parametrize("reason", [Reason.OPERATOR, Reason.FALLEN])
def test_a_step_in_which_a_robot_stops_or_falls_is_one_that_stopped(reason):
    env = env_of(2)
    hold = np.zeros((2, N))
    while not env.runtime.supervisor.running.all():
        env.step(torch.from_numpy(hold))
    env.runtime.requested_stop[1] = int(reason)
    env.get_observations()
    assert env.episodes.run(hold).stopped.tolist() == [False, True]
