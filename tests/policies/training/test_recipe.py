"""Actions that follow from a recipe's promise, and recipes that do not fit their robot."""

import tomllib
from functools import partial

import numpy as np
import pytest

from deploy.telemetry.folder_lock import LOCK, locked
from policies.training.recipe import RECIPES, Promise, Recipe, contract_of, find_recipe, load_recipe
from robots.errors import ConfigError, ContractError
from robots.models.nominal_model import torque_max
from robots.strict import parse
from support.arm6 import SPEC, copy_of_arm
from support.quadruped import QUADRUPED
from support.refusals import in_use

RECIPE = load_recipe(find_recipe("arm"))
LOW, HIGH = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
NO_TARGET = ("joint_position", "joint_velocity", "last_action")


def recipe(observation=NO_TARGET, **promise):
    changed = Promise(policy_hz=50, reach_m=0.85, **promise)
    return RECIPE.model_copy(update={"promise": changed, "observation": observation})


FULL = {
    "position": (HIGH - LOW) / 4,
    "velocity": SPEC.joint_array("qd_max") / 2,
    "torque": torque_max(SPEC) / 2,
}


@pytest.mark.parametrize("mode", FULL)
def test_full_action_is_a_share_of_the_limit(mode):
    action = contract_of(recipe(mode=mode, share=0.5), SPEC, {}).action
    assert (action.mode, action.clip, action.leash_rad) == (mode, (-1.0, 1.0), None)
    np.testing.assert_allclose(action.scale, FULL[mode], rtol=1e-12)
    offset = (LOW + HIGH) / 2 if mode == "position" else None
    assert action.offset == (None if offset is None else tuple(offset))


@pytest.mark.parametrize("mode", FULL)
def test_change_of_a_target_is_a_share_of_a_full_action(mode):
    action = contract_of(recipe(mode=mode, share=0.5, change_share=0.2), SPEC, {}).action
    np.testing.assert_allclose(action.change_max, 0.2 * FULL[mode], rtol=1e-12)
    assert contract_of(recipe(mode=mode, share=0.5), SPEC, {}).action.change_max is None


WRONG = {
    "share of increments": (
        {"share": 0.5, "increment_rad": 0.1, "leash_rad": 0.3},
        "share: found 0.5 in mode",
    ),
    "no leash": ({"increment_rad": 0.1}, "leash_rad: missing in mode 'position_increment'"),
    "leash of a speed": (
        {"mode": "velocity", "share": 1.0, "leash_rad": 0.3},
        "leash_rad: found 0.3 in mode 'vel",
    ),
    "change of increments": (
        {"change_share": 0.5, "increment_rad": 0.1, "leash_rad": 0.3},
        "change_share: found 0.5 in mode 'position_increment', expected none",
    ),
    "no share": ({"mode": "torque"}, "share: missing in mode 'torque'"),
}


@pytest.mark.parametrize(("promise", "message"), WRONG.values(), ids=WRONG)
def test_fields_of_another_mode_are_refused(promise, message):
    with pytest.raises(ConfigError, match=f"x.toml: promise.{message}"):
        parse({"policy_hz": 50, "reach_m": 0.85, **promise}, Promise, source="x.toml")


ARM = tomllib.loads((RECIPES / "arm.toml").read_text())


@pytest.mark.parametrize(
    ("table", "field", "value"),
    [
        ("environment", "robots", 10**9),
        ("environment", "goals_per_episode", 10**18),
        ("learner", "num_steps_per_env", 10**15),
        ("learner", "num_mini_batches", 10**6),
        ("learner", "num_mini_batches", 256 * 24 // 2 + 1),
        ("learner", "init_std", 1e308),
        ("learner", "max_grad_norm", 1e7),
        ("learner", "entropy_coef", 1e7),
        ("reward", "success", 1e308),
        ("shaping", "stop", -1e308),
        ("learner", "stages", [{"iterations": 10**18, "learning_rate": 1e-3}]),
        ("learner", "hidden", []),
        ("learner", "hidden", [10**9]),
        ("learner", "hidden", [65536, 65536]),
        ("learner", "hidden", [4096] * 3),
        ("seed", "", 2**63),
    ],
)
def test_numbers_that_no_training_can_use_are_refused(table, field, value):
    wrong = ARM | {table: ARM[table] | {field: value} if field else value}
    with pytest.raises(ConfigError, match=rf"x\.toml: {table}\.?{field}"):
        parse(wrong, Recipe, source="x.toml")


def test_a_batch_that_no_memory_holds_is_refused():
    wrong = ARM | {"environment": ARM["environment"] | {"robots": 16384}}
    wrong |= {"learner": ARM["learner"] | {"num_steps_per_env": 65536}}
    said = "environment.robots times learner.num_steps_per_env: found 1073741824, expected at most 4194304"
    with pytest.raises(ConfigError, match=rf"x\.toml: .*{said}"):
        parse(wrong, Recipe, source="x.toml")


def test_a_mini_batch_whose_gradients_no_memory_holds_is_refused():
    learner = ARM["learner"] | {"num_steps_per_env": 256, "hidden": [4096, 4096], "num_mini_batches": 2}
    parse(ARM | {"learner": learner}, Recipe, source="x.toml")
    said = r"num_mini_batches, times the sum of hidden: found 536870912, expected at most 268435456"
    with pytest.raises(ConfigError, match=rf"x\.toml: .*{said}"):
        parse(ARM | {"learner": learner | {"num_mini_batches": 1}}, Recipe, source="x.toml")


def test_too_long_a_name_of_a_recipe_is_no_recipe():
    with pytest.raises(
        ConfigError, match=r"--recipe x+: no such file, expected a path or one of policies/: "
    ):
        find_recipe("x" * 300)


def test_the_bound_of_a_network_is_named(tmp_path):
    text = find_recipe("arm").read_text(encoding="utf-8")
    path = tmp_path / "wide.toml"
    path.write_text(text.replace("hidden = [128, 128]", "hidden = [4096, 4096, 1]"))
    with pytest.raises(ConfigError) as caught:
        load_recipe(path)
    expected = "16781312 weights between layers, expected at most 16777216, found (4096, 4096, 1)"
    assert str(caught.value) == f"{path}: learner.hidden: {expected}"
    path.write_text(text.replace("hidden = [128, 128]", "hidden = [4096, 4096]"))
    assert load_recipe(path).learner.hidden == (4096, 4096)


def test_offset_of_a_target_that_is_no_angle_is_refused():
    with pytest.raises(ConfigError, match="target_offset"):
        contract_of(recipe(("joint_position", "target_offset"), mode="velocity", share=1.0), SPEC, {})


# ---- recipes that do not fit their robot ----

WALK = {"task": "velocity", "observation": ("joint_position", "velocity_command")}
SPEED = Promise(mode="velocity", policy_hz=50, share=1.0, reach_m=0.85)
MISFITS = {
    "mode": (
        {**WALK, "promise": SPEED},
        QUADRUPED,
        r"promise\.mode: found 'velocity'; the drives of quadruped have the modes position",
    ),
    "capability": (WALK, SPEC, r"task: found 'velocity', which needs \[floating_base\]; arm6 has "),
    "task's own check": (
        {"task": "planar_reach", "observation": None},
        QUADRUPED,
        r"task: found 'planar_reach', which needs \[tool\]; quadruped has ",
    ),
    "unknown task": ({"task": "dance"}, SPEC, r"task: found 'dance': unknown; known: planar_reach, "),
    "rate": (
        {"observation": NO_TARGET, "promise": SPEED.model_copy(update={"policy_hz": 60})},
        SPEC,
        "contract: policy_hz 60 does not divide control_hz 200",
    ),
}


@pytest.mark.parametrize(("changes", "spec", "message"), MISFITS.values(), ids=MISFITS)
def test_a_recipe_that_does_not_fit_its_robot_is_refused(changes, spec, message):
    with pytest.raises(ConfigError, match=f"recipe arm: {message}"):
        contract_of(RECIPE.model_copy(update=changes), spec, {})


def test_the_finished_contract_is_compared_with_the_robot(monkeypatch):
    def one_line(contract, spec):
        yield f"robot: found {contract.robot!r}, expected 'another'"

    monkeypatch.setattr("deploy.policy.compatibility.mismatches", one_line)
    with pytest.raises(ContractError, match="recipe arm: contract: robot: found 'arm6', expected 'another'"):
        contract_of(RECIPE, SPEC, {})


@pytest.fixture
def train(call):
    """The command policy-train, called with options."""
    pytest.importorskip("rsl_rl")
    pytest.importorskip("av")
    from policies.training.cli import cli

    return partial(call, cli)


def test_a_training_that_cannot_be_done_writes_nothing(train, tmp_path):
    spec = copy_of_arm(
        tmp_path, toml=[(r'modes = \["position", "velocity", "torque"\]', 'modes = ["position"]')]
    )
    text = find_recipe("planar3_velocity").read_text(encoding="utf-8")
    for old, new in (('"planar3"', f'"{spec}"'), ("planar_reach", "reach")):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "fast.toml").write_text(text)
    code, _, complaint = train("--recipe", tmp_path / "fast.toml", "--out", tmp_path / "out")
    assert code == 2
    assert complaint.startswith(
        f"error: {tmp_path / 'fast.toml'}: promise.mode: found 'velocity'; the drives of arm6"
    )
    assert not (tmp_path / "out").exists()


def test_the_folder_of_a_running_training_is_refused(train, tmp_path):
    with locked(tmp_path):
        assert train("--out", tmp_path) == (2, "", f"error: {in_use(tmp_path)}\n")
        assert [path.name for path in tmp_path.iterdir()] == [LOCK]


def test_a_link_of_another_training_is_refused_even_if_it_leads_nowhere(train, tmp_path):
    (tmp_path / "arm.png").symlink_to(tmp_path / "elsewhere" / "plot.png")
    expected = f"error: --out {tmp_path}: found arm.png of another training, expected another folder\n"
    assert train("--out", tmp_path) == (2, "", expected)


@pytest.mark.parametrize(
    "name", ["events.out.tfevents.1", "x.tfevents.2", "model_200.pt", "arm.pt", "arm.png"]
)
def test_files_of_another_training_are_kept(train, tmp_path, name):
    (tmp_path / name).write_text("of the other training")
    expected = f"error: --out {tmp_path}: found {name} of another training, expected another folder\n"
    assert train("--out", tmp_path) == (2, "", expected)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "of the other training"
