"""A task of another package: found by its entry point, it runs, trains, is exported and soaks."""

import json
import re

import numpy as np
import pytest

from deploy.policy.contract import Contract
from deploy.tasks.task import find_task, sources_of, tasks_of
from eval.shard.job import code_digest
from robots.errors import ConfigError, ContractError
from support.arm6 import SPEC
from support.contracts import arm_contract
from support.runtimes import built, play

OUTSIDE = '''
"""Turn the first joint to one angle after another."""
import numpy as np
from deploy.sources.maximum import UNITY
from deploy.sources.source import ObservationSource
from deploy.tasks.success import SuccessCriterion
from deploy.tasks.task import Task

class Turn(Task):
    name, size = "turn", 1
    sources = {
        "angle_left": ObservationSource(
            frame="joint", unit="rad", sensing="proprioceptive", maximum=UNITY, meaning="angle left to turn: encoder",
            read=lambda runtime: runtime.task.goal - runtime.task.achieved,
        )
    }
    observation = (*Task.observation, "angle_left")

    @classmethod
    def success_criterion(cls, spec):
        return SuccessCriterion(size=1, period_s=0.5, tolerance=0.05)

    @classmethod
    def true_achieved(cls, truth):
        return truth.q[:, :1]

    def sample_goal(self, rng):
        return self.spec.joint_array("q_home")[:1] + rng.uniform(-0.1, 0.1, 1)

    def observe(self, runtime, sample, due):
        self.achieved[:] = runtime.state.q[:, :1]
'''


@pytest.fixture
def outside(installed):
    """The folder of an installed distribution that declares the task."""
    return installed("turning", OUTSIDE, "tasks", "turn = turning:Turn")


def turning_contract():
    term = {
        "name": "left",
        "source": "angle_left",
        "frame": "joint",
        "unit": "rad",
        "size": 1,
        "scale": (1.0,),
    }
    data = arm_contract().model_dump() | {"task": "turn", "observation": (term,)}
    return Contract.model_validate(data)


def test_the_tasks_of_a_robot_are_those_whose_capabilities_it_has(outside):
    assert tasks_of(SPEC) == ("reach", "turn")
    assert find_task("turn", "task").__module__ == "turning"
    assert "angle_left" in sources_of("turn")
    assert "angle_left" not in sources_of("reach")


def test_a_task_that_is_not_installed_is_refused():
    with pytest.raises(ConfigError, match=r"task turn: unknown; known: planar_reach, reach, velocity"):
        find_task("turn", "task turn")
    text = arm_contract().to_json().replace('"task":"reach"', '"task":"turn"')
    with pytest.raises(
        ContractError, match=r"x: .*task: found 'turn': unknown; known: planar_reach, reach, velocity"
    ):
        Contract.from_json(text, "x")


def test_a_contract_may_name_the_sources_of_its_own_task_only(outside):
    text = turning_contract().to_json().replace('"task":"turn"', '"task":"reach"')
    with pytest.raises(
        ContractError, match=r"term 'left': source: found 'angle_left', expected one of joint_position"
    ):
        Contract.from_json(text, "x")


@pytest.mark.usefixtures("outside")
def test_a_task_of_another_package_runs():
    runtime = built(2, contract=turning_contract())
    play(runtime, 220)
    assert runtime.task.name == "turn"
    assert runtime.task.attempted.tolist() == [2, 2]
    np.testing.assert_array_equal(runtime.task.achieved, runtime.state.q[:, :1])


def test_the_source_of_an_outside_task_is_part_of_the_code_digest(outside):
    without = code_digest()
    source = outside / "turning.py"
    source.rename(source.with_name("turning_now.py"))
    (outside / "turning").mkdir()
    package = outside / "turning" / "__init__.py"
    package.write_text((outside / "turning_now.py").read_text())
    as_package = code_digest()
    assert len({without, as_package}) == 2


@pytest.mark.slow
@pytest.mark.usefixtures("outside")
def test_a_task_of_another_package_trains_and_soaks(call, tmp_path):
    pytest.importorskip("torch")
    from eval.soak.cli import cli as soak_test
    from policies.export.cli import cli as policy_export
    from policies.training.cli import cli as policy_train
    from policies.training.recipe import find_recipe

    recipe = find_recipe("arm").read_text(encoding="utf-8").replace('task = "reach"', 'task = "turn"')
    head, _, _ = recipe.replace("robots = 256", "robots = 8").partition("[[learner.stages]]")
    small = re.sub("goals_per_episode = .*", "goals_per_episode = 1", head)
    stages = "[[learner.stages]]\niterations = 1\nlearning_rate = 1e-3\n"
    (tmp_path / "turn.toml").write_text(small.replace('name = "arm"', 'name = "turn"') + stages)
    assert call(policy_train, "--recipe", tmp_path / "turn.toml", "--out", tmp_path / "train")[0] == 0
    policy, checkpoint = tmp_path / "turn.onnx", tmp_path / "train" / "turn.pt"
    assert call(policy_export, "--policy", checkpoint, "--out", policy)[0] == 0
    options = ("--hours", 2 / 3600, "--robots", 17, "--workers", 2, "--out", tmp_path / "soak")
    assert call(soak_test, "--policy", policy, *options)[0] in (0, 1)
    report = json.loads((tmp_path / "soak" / "report.json").read_text())
    assert [robot["goals_due"] for robot in report["robots"]] == [4] * 17
