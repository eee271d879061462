"""Options of environments, and refusals of wrong ones."""

import shutil

import pytest

gymnasium = pytest.importorskip("gymnasium")

from policies.environments.registry import environment_ids
from policies.environments.settings import read_settings
from policies.training.recipe import find_recipe, load_recipe
from robots.errors import ConfigError, RobotError
from support.arm6 import SPEC
from support.walking import QUADRUPED

ARM = {"robot": "arm6", "task": "reach", "mode": "position"}
FIRST = "firstshift/arm6-reach-position"
REFUSED = {
    "unknown option": ({"colour": "red"}, r"option colour: found 'red', expected one of robot, task, mode"),
    "type": ({"threads": 0}, r"option: threads: Input should be greater than 0, found 0"),
    "task of another robot": ({"task": "velocity"}, r"option task: arm6: found 'velocity', expected .*reach"),
    "mode of other drives": (
        {"mode": "warp"},
        r"option mode: drives of arm6: found 'warp', expected position",
    ),
    "recipe": ({"recipe": "leg"}, r"--recipe leg: no such file, expected a path or one of policies/: .*arm"),
}


def test_every_robot_task_and_mode_is_registered():
    assert environment_ids()[f"{FIRST}-v0"] == ARM
    assert all(name in gymnasium.registry for name in environment_ids())
    spec = gymnasium.spec(f"policies.environments.registry:{FIRST}-v0".split(":")[1])
    assert spec.kwargs == ARM


def test_hindsight_is_for_goals_that_one_step_reaches():
    walk = "firstshift/quadruped-{}-position{}-v0"
    assert walk.format("velocity", "") in gymnasium.registry
    assert walk.format("velocity", "-goal") not in gymnasium.registry
    assert walk.format("waypoint", "-goal") in gymnasium.registry
    with pytest.raises(
        ConfigError, match="option task: found 'velocity', whose goals count by the mean of their period"
    ):
        gymnasium.make(f"{FIRST}-goal-v0", robot="quadruped", task="velocity")


@pytest.mark.slow
@pytest.mark.parametrize("name", environment_ids())
def test_every_environment_runs_in_its_mode(name):
    env = gymnasium.make(name)
    env.action_space.seed(1)
    env.reset(seed=1)
    running = [env.step(env.action_space.sample())[-1]["running"] for _ in range(20)]
    assert any(running)  # random torques may have stopped it since
    contract = env.unwrapped.session.settings.contract
    assert contract.action.control_mode.name.lower() == environment_ids()[name]["mode"]


def test_environment_has_the_contract_and_the_goals_of_its_recipe():
    recipe, settings = load_recipe(find_recipe("arm")), read_settings(ARM, goal=False)
    assert settings.recipe == recipe
    assert settings.contract.policy_hz == recipe.promise.policy_hz
    goal = read_settings(ARM, goal=True)
    assert goal.recipe.environment.goals_per_episode == 1
    left = {term.source for term in settings.contract.observation} - {
        term.source for term in goal.contract.observation
    }
    assert left == {"goal_from_tool", "goal_torque"}


def test_robot_without_a_recipe_gets_the_template(tmp_path):
    folder = shutil.copytree(SPEC.folder, tmp_path / "arm7")
    text = (folder / "robot.toml").read_text()
    assert text.count('name = "arm6"') == 1
    text = text.replace('name = "arm6"', 'name = "arm7"')
    (folder / "robot.toml").write_text(text.replace("_hz = 200", "_hz = 125"))
    settings = read_settings({**ARM, "robot": str(folder)}, goal=False)
    assert (settings.recipe.name, settings.recipe.robot) == ("arm7-reach-position", "arm7")
    assert settings.contract.policy_hz == 25
    walker = {"robot": str(QUADRUPED.folder), "task": "velocity", "mode": "position"}
    assert read_settings(walker, goal=False).contract.task == "velocity"


@pytest.mark.parametrize(("options", "message"), REFUSED.values(), ids=REFUSED)
def test_wrong_option_is_named_with_what_was_expected(options, message):
    with pytest.raises(ConfigError, match=message):
        gymnasium.make(f"{FIRST}-v0", **options)
    with pytest.raises(ConfigError, match=message):
        gymnasium.make_vec(f"{FIRST}-goal-v0", num_envs=2, **options)


OBSERVED = {
    "template": ("planar_9", ("joint_position", "tool_position", "goal_position"), 9),
    "sources": (["goal_torque", "joint_position"], ("goal_torque", "joint_position"), 6),
}


@pytest.mark.parametrize(("observation", "sources", "size"), OBSERVED.values(), ids=OBSERVED)
@pytest.mark.parametrize("mode", ["position", "velocity"])
def test_an_observation_takes_the_place_of_the_recipes(observation, sources, size, mode):
    name = f"firstshift/planar3-planar_reach-{mode}"
    own = gymnasium.make(f"{name}-v0").unwrapped.session.settings.recipe
    with gymnasium.make(f"{name}-v0", observation=observation) as env:
        settings = env.unwrapped.session.settings
        assert tuple(term.source for term in settings.contract.observation) == sources
        assert env.reset(seed=1)[0].shape == (size,)
        assert settings.recipe.model_copy(update={"observation": own.observation}) == own
    envs = gymnasium.make_vec(f"{name}-goal-v0", num_envs=2, observation=observation)
    seen, _ = envs.reset(seed=1)
    assert seen["observation"].shape == (2, size - 3)


def test_the_gait_of_a_recipe_is_left_out_where_it_is_not_observed(tmp_path):
    text = find_recipe("arm").read_text().replace('"arm6"', '"quadruped"').replace('"reach"', '"velocity"')
    text = text.replace("seed = 1\n", 'seed = 1\nobservation = ["joint_position", "gait_phase"]\n', 1)
    (tmp_path / "trot.toml").write_text(text + "\n[gait]\nperiod_s = 0.5\nphase_offsets = [0.0, 0.5]\n")
    walk = {
        "robot": "quadruped",
        "task": "velocity",
        "mode": "position",
        "recipe": str(tmp_path / "trot.toml"),
    }
    assert read_settings(walk, goal=False).contract.period_s == 0.5
    settings = read_settings({**walk, "observation": "egocentric"}, goal=False)
    assert (settings.recipe.gait, settings.contract.observation_size) == (None, 41)


WRONG = {
    "template": ("unit", "option observation: found 'unit', expected a list of sources, or one of unit_24"),
    "other robot": ("planar_9", "option observation: 'planar_9' has 12 numbers on arm6, expected 9"),
    "source": (["knee"], "option observation: found 'knee', expected sources among"),
    "none": ([], "option: observation"),
    "type": (3, "option: observation"),
    "goal alone": (["goal_torque"], "option observation: found only goal_torque, which depend on the goal"),
}


@pytest.mark.parametrize(("observation", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_observation_is_refused(observation, message):
    with pytest.raises(ConfigError, match=message):
        gymnasium.make(f"{FIRST}-goal-v0", observation=observation)


def test_unknown_render_mode_is_refused():
    message = r"option: render_mode: .*'human' or 'rgb_array', found 'ansi'"
    with pytest.warns(UserWarning, match="render_mode='ansi'"), pytest.raises(ConfigError, match=message):
        gymnasium.make(f"{FIRST}-v0", render_mode="ansi")


def test_unknown_robot_is_refused():
    with pytest.raises(RobotError, match=r"--robot arm9: no such folder .*known: .*arm6"):
        gymnasium.make(f"{FIRST}-v0", robot="arm9")


def test_recipe_for_another_robot_is_refused(tmp_path):
    text = find_recipe("arm").read_text()
    (tmp_path / "a.toml").write_text(text.replace('robot = "arm6"', 'robot = "arm5"'))
    path = str(tmp_path / "a.toml")
    with pytest.raises(ConfigError, match=r"option recipe: .*a.toml: robot: found 'arm5', expected arm6"):
        gymnasium.make(f"{FIRST}-v0", recipe=path)


@pytest.mark.parametrize("option", ["num_envs", "max_episode_steps"])
def test_nothing_to_simulate_is_refused(option):
    with pytest.raises(ConfigError, match=f"option {option}: found 0, expected at least 1"):
        gymnasium.make_vec(f"{FIRST}-v0", **{"num_envs": 2, option: 0})
