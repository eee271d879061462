"""Success of goals that count by the mean of their period, in an environment of a walking robot."""

import shutil

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

import policies.environments.registry as _registered
from support.quadruped import QUADRUPED

PERIOD = 100
"""Ticks of a command of half a second."""
EXPECTED = {
    "misses on one side, then on the other": True,
    "misses until the end": False,
    "before arming": True,
}
ROBOTS, FAR = len(EXPECTED), np.array([3.0, 0.0, 0.0])

assert _registered


def missed(task, powered):
    """(B, 3) m/s, m/s, rad/s by which each robot misses its command after a tick."""
    tick = np.where(task.ended, PERIOD, task.elapsed)
    side = -1.0 if tick[0] > PERIOD / 2 else 1.0
    return np.outer([side, tick[1] < PERIOD, not powered[2]], FAR)


@pytest.fixture
def envs(tmp_path, monkeypatch):
    """Robots that stand, with true velocities that miss their commands."""
    folder = shutil.copytree(QUADRUPED.folder, tmp_path / "quadruped")
    text = (folder / "robot.toml").read_text()
    assert "command_s = 10.0" in text
    (folder / "robot.toml").write_text(text.replace("command_s = 10.0", "command_s = 0.5"))
    envs = gymnasium.make_vec("firstshift/quadruped-velocity-position-v0", num_envs=ROBOTS, robot=str(folder))
    envs.reset(seed=1)
    task, supervisor = envs.session.episodes.task, envs.session.episodes.runtime.supervisor

    def achieved(truth):
        goal = np.where(task.ended[:, None], task.ended_goal, task.goal)
        return goal + missed(task, supervisor.powered)

    monkeypatch.setattr(task, "true_achieved", achieved)
    return envs


def test_success_is_that_of_the_mean_since_the_command_was_given(envs):
    episodes, steps = envs.session.episodes, []
    run = episodes.run
    episodes.run = lambda action: steps.append(run(action)) or steps[-1]
    success, ended = [], []
    for _ in range(45):
        *_, info = envs.step(np.zeros(envs.action_space.shape, np.float32))
        success.append(info["is_success"])
        ended.append(episodes.task.ended.copy())
    success, ended = np.array(success), np.array(ended)
    assert (ended.sum(axis=0) == 1).all()
    reached = np.array([step.reached for step in steps])
    assert reached.any(axis=0).tolist() == list(EXPECTED.values())
    assert not (reached & ~ended).any()
    np.testing.assert_array_equal(success[ended], reached[ended])
    halfway = np.argmax(ended, axis=0) - PERIOD // 8
    assert success[halfway, np.arange(ROBOTS)].tolist() == [False, False, True]
