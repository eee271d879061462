"""I/O descriptors of Isaac Lab: one that it published, and others like it."""

import copy
import time
import tomllib

import numpy as np
import pytest

yaml = pytest.importorskip("yaml")
pytest.importorskip("tomlkit")

from onnx import numpy_helper

from deploy.policy.policy import Policy
from policies.importers.cli import import_policy, policy_import, write_template
from policies.importers.contract_draft import read_draft
from policies.importers.onnx_files.isaac_lab import read_descriptor
from policies.importers.untrusted.yaml_file import CHARACTERS_MAX
from robots.errors import ConfigError, ContractError
from support.arm6 import SPEC
from support.contracts import NAMES
from support.importers.onnx_metadata import graph
from support.paths import DATA, TEST_ROBOTS

ANYMAL = DATA / "isaac_lab_anymal_d_io_descriptors.yaml"
LEGS = ("LF", "LH", "RF", "RH")
JOINTS = [f"{leg}_{joint}" for joint in ("HAA", "HFE", "KFE") for leg in LEGS]
POSE = [0.0] * 4 + [0.4000000059604645, -0.4000000059604645] * 2 + [-0.800000011920929, 0.800000011920929] * 2


class Plain(yaml.SafeDumper):
    """Says everything in full."""

    def ignore_aliases(self, data):
        return True


def anymal():
    return yaml.safe_load(ANYMAL.read_text())


def written(folder, data):
    path = folder / "io.yaml"
    path.write_text(data if isinstance(data, str) else yaml.dump(data, Dumper=Plain))
    return path


def term(data, name):
    return next(term for term in data["observations"]["policy"] if term["name"] == name)


def refused(path, observations=48):
    with pytest.raises(ContractError) as caught:
        read_descriptor(path, observations)
    message = str(caught.value)
    assert all(line.startswith(f"{path}: ") for line in message.splitlines())
    assert len(message) < 1000
    return message.removeprefix(f"{path}: ")


def test_a_descriptor_that_isaac_lab_published_fills_the_contract():
    known = read_descriptor(ANYMAL, 48)
    assert (known["joint_names"], known["policy_hz"]) == (JOINTS, 50)
    assert known["action"] == {"mode": "position", "offset": POSE, "multiply": 0.5, "clip": "none"}
    terms = {each["name"]: each for each in known["observation"]}
    assert list(terms) == [
        *("base_lin_vel", "base_ang_vel", "projected_gravity", "generated_commands"),
        *("joint_pos_rel", "joint_vel_rel", "last_action"),
    ]
    assert terms["joint_pos_rel"] == {
        "name": "joint_pos_rel",
        "source": "joint_position",
        "offset": POSE,
        "multiply": 1.0,
        "clip": "none",
        "clip_first": True,
        "history": 1,
    }
    assert (terms["joint_vel_rel"]["source"], terms["joint_vel_rel"]["offset"]) == ("joint_velocity", "none")
    assert "source" not in terms["generated_commands"]  # the file does not say which
    assert known.keys().isdisjoint({"robot", "layout", "task"})


def test_scales_bounds_histories_and_gains_are_carried_over(tmp_path):
    data = anymal()
    velocity, position = term(data, "joint_vel_rel"), term(data, "joint_pos_rel")
    velocity["overloads"] |= {"scale": 0.05, "clip": [-100.0, float("inf")], "history_length": 5}
    position |= {"name": "joint_pos", "joint_pos_offsets": None}
    data["observations"]["policy"].append(copy.deepcopy(term(data, "base_ang_vel")))
    data["articulations"]["robot"] |= {
        "joint_names": JOINTS[::-1],
        "default_joint_stiffness": [float(k + 1) for k in range(12)],
        "default_joint_damping": [0.1] * 12,
    }
    data["actions"][0] |= {"scale": [[0.5] * 12] * 4, "offset": 0.0, "clip": [[-1.0, 1.0]] * 12}
    known = read_descriptor(written(tmp_path, data), 48 + 4 * 12 + 3)
    terms = {each["name"]: each for each in known["observation"]}
    assert (
        terms["joint_vel_rel"] | {"multiply": 0.05, "clip": [-100.0, 1e30], "history": 5}
        == terms["joint_vel_rel"]
    )
    assert (known["layout"], known["frames"], known["fill"]) == ("by_term", "oldest_first", "first")
    assert terms["joint_pos"]["offset"] == "none"  # what it is by itself, not beside a pose
    assert terms["base_ang_vel_2"]["source"] == "base_angular_velocity"
    assert known["action"] == {
        "mode": "position",
        "offset": "none",
        "multiply": [0.5] * 12,
        "clip": [-2.0, 2.0],  # of the raw action: Isaac Lab bounds the target
        "kp": [float(12 - k) for k in range(12)],
        "kd": [0.1] * 12,
    }


def test_unknown_action_fields_stay_open(tmp_path):
    data = anymal()
    data["actions"][0]["clip"] = [[-1.0, 1.0]] * 12  # about other poses: other bounds for each
    assert "clip" not in read_descriptor(written(tmp_path, data), 48)["action"]
    data["actions"][0]["full_path"] = "isaaclab.envs.mdp.actions.joint_actions.RelativeJointPositionAction"
    assert read_descriptor(written(tmp_path, data), 48)["action"] == {}


def test_a_template_with_its_descriptor_needs_little_more(tmp_path, capsys):
    names = [NAMES[k] for k in (3, 0, 5, 1, 4, 2)]
    data = anymal()
    kept = [term(data, name) for name in ("joint_pos_rel", "joint_vel_rel", "last_action")]
    for each in kept:
        each["shape"] = [6]
    for each in kept[:2]:
        each["joint_names"] = names
    kept[0]["joint_pos_offsets"], kept[1]["joint_vel_offsets"] = [0.1] * 6, [0.0] * 6
    data["observations"]["policy"] = kept
    data["actions"][0] |= {"joint_names": names, "offset": [0.1] * 6, "shape": [6]}
    model = graph({}, 18, 6)
    (tmp_path / "policy.onnx").write_bytes(model.SerializeToString())
    draft, said = tmp_path / "policy.toml", written(tmp_path, data)
    assert policy_import(tmp_path / "policy.onnx", template=True, descriptor=said) == 0
    assert capsys.readouterr().out.endswith("; fill in 4 values marked ?\n")
    text = draft.read_text()
    for field, answer in {"robot": '"arm6"', "task": '"reach"', "kp": '"none"', "kd": '"none"'}.items():
        assert f'{field} = "?"' in text
        text = text.replace(f'{field} = "?"', f"{field} = {answer}")
    draft.write_text(text)
    assert read_draft(draft).joint_names == tuple(names)
    assert 0 <= import_policy(tmp_path / "policy.onnx", draft, tmp_path / "mine.onnx").deviation <= 1e-5


def test_missing_joints_are_observed_at_their_default_pose(tmp_path):
    moved = [NAMES[k] for k in (3, 0, 5, 1, 4, 2)]
    seen = ["left_finger", *moved[::-1], "right_finger"]
    data = anymal()
    kept = [term(data, name) for name in ("joint_pos_rel", "joint_vel_rel", "last_action")]
    kept[0] |= {"joint_names": seen, "joint_pos_offsets": [0.5] * 8, "shape": [8]}
    kept[1] |= {"joint_names": seen, "joint_vel_offsets": [0.0] * 8, "shape": [8]}
    kept[2]["shape"] = [6]
    kept[0]["overloads"]["history_length"] = 2
    data["observations"]["policy"] = kept
    data["actions"][0] |= {"joint_names": moved, "offset": [0.1] * 6, "shape": [6]}
    model = graph({}, 30, 6)
    weights = np.random.default_rng(0).normal(size=(30, 6)).astype(np.float32)
    model.graph.initializer[0].CopyFrom(numpy_helper.from_array(weights, "w"))
    (tmp_path / "a.onnx").write_bytes(model.SerializeToString())
    draft, out = tmp_path / "a.toml", tmp_path / "mine.onnx"
    write_template(tmp_path / "a.onnx", draft, written(tmp_path, data))
    text = draft.read_text()
    for field, answer in {"robot": '"arm6"', "task": '"reach"', "kp": '"none"', "kd": '"none"'}.items():
        text = text.replace(f'{field} = "?"', f"{field} = {answer}")
    draft.write_text(text)
    assert import_policy(tmp_path / "a.onnx", draft, out).deviation <= 1e-5

    policy = Policy.load(out, SPEC)
    assert [each.size * each.history for each in policy.contract.observation] == [12, 6, 6]
    ours = np.random.default_rng(1).normal(size=(3, 24)).astype(np.float32)
    places = np.array([NAMES.index(name) for name in seen[1:-1]])
    still = np.zeros((3, 1), np.float32)
    theirs = [part for start in (0, 6, 12) for part in (still, ours[:, start + places], still)]
    order = [NAMES.index(name) for name in moved]
    expected = np.concatenate([*theirs, ours[:, 18 + np.array(order)]], axis=1) @ weights
    np.testing.assert_allclose(policy.replay(ours, 3)[:, order], expected, rtol=0, atol=1e-5)


def test_policy_file_overrides_the_descriptor(tmp_path):
    from support.importers.onnx_metadata import MJLAB

    model = graph({"joint_names": MJLAB["joint_names"], "action_scale": "0.25"}, 48, 3)
    (tmp_path / "a.onnx").write_bytes(model.SerializeToString())
    facts, _ = write_template(tmp_path / "a.onnx", tmp_path / "a.toml", ANYMAL)
    assert facts.known["action"]["multiply"] == 0.25
    assert facts.known["joint_names"] == MJLAB["joint_names"].split(",")
    assert facts.known["policy_hz"] == 50


@pytest.mark.parametrize(
    ("robot", "name", "task"),
    [("arm6", "arm6", "reach"), (TEST_ROBOTS / "quadruped", "quadruped", "velocity")],
)
def test_a_template_for_a_robot_names_it_and_its_task(tmp_path, robot, name, task):
    (tmp_path / "a.onnx").write_bytes(graph({}, 48, 12).SerializeToString())
    policy_import(tmp_path / "a.onnx", template=True, robot=str(robot))
    draft = tomllib.loads((tmp_path / "a.toml").read_text())
    assert (draft["robot"], draft["task"]) == (name, task)


def test_a_descriptor_is_for_templates(tmp_path):
    with pytest.raises(ConfigError, match=r"--descriptor .*: found without --template, expected both"):
        policy_import(tmp_path / "a.onnx", descriptor=ANYMAL)


# ---- what is refused ----

BAD = {
    "another policy": (
        lambda d: d["observations"]["policy"].pop(),
        "observations.policy: found 36 numbers, the policy",
    ),
    "two actions": (
        lambda d: d["actions"].append(d["actions"][0].copy()),
        "actions: Tuple should have at most 1 item",
    ),
    "no rate": (lambda d: d.pop("scene"), "scene: Field required"),
    "rate of zero": (
        lambda d: d["scene"].update(dt=0.0),
        "scene.dt: Input should be greater than or equal to 0.00001",
    ),
    "no number": (lambda d: d["actions"][0].update(scale="0.5"), "actions.0.scale"),
    "modified": (
        lambda d: d["observations"]["policy"][0]["extras"].update(modifiers=["x"]),
        "observations.policy.0.extras.modifiers: Input should be None",
    ),
    "image": (
        lambda d: d["observations"]["policy"][0].update(shape=[3, 64, 64]),
        "observations.policy.0.shape: Tuple should have at most 1 item",
    ),
    "history beside": (
        lambda d: d["observations"]["policy"][0]["overloads"].update(
            history_length=1, flatten_history_dim=False
        ),
        "observations.policy: base_lin_vel: flatten_history_dim: found false, expected true",
    ),
}


@pytest.mark.parametrize("kind", BAD)
def test_fields_without_a_contract_equivalent_are_refused(tmp_path, kind):
    change, message = BAD[kind]
    data = anymal()
    change(data)
    assert refused(written(tmp_path, data)).startswith(message)


def test_action_joints_are_a_subset_in_any_order(tmp_path):
    data = anymal()
    data["actions"][0] |= {"joint_names": JOINTS[:3:-1], "offset": POSE[:3:-1]}
    known = read_descriptor(written(tmp_path, data), 48)
    assert (known["joint_names"], known["action_joints"]) == (JOINTS, JOINTS[:3:-1])
    data["actions"][0]["joint_names"] = ["finger"]
    assert refused(written(tmp_path, data)).startswith("observations.policy: joint_names: found ['LF_HAA',")
    term(data, "joint_vel_rel")["joint_names"] = JOINTS[::-1]
    assert refused(written(tmp_path, data)).startswith("observations.policy: joint_names: found ['RH_KFE',")


BOMB = "0: &0 [x, x]\n" + "".join(f"{k}: &{k} [*{k - 1}, *{k - 1}]\n" for k in range(1, 30))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "line 2: found the alias '0', expected each value in full"),
        (
            "a: !!python/object/apply:os.system [touch escaped]",
            "line 1: found the tag 'tag:yaml.org,2002:python/object/apply:os.system', expected none",
        ),
        ("[" * 100_000, "found more than 20 nested levels"),
        ("{" * 5_000, "found more than 20 nested levels"),
        (
            "a: " + "9" * 10_000,
            "found the number 99999999999999999999… of 10000 digits, expected at most 100",
        ),
        ("a: [1", "not valid YAML: expected ',' or ']'"),
        ("\x00", "not valid YAML: "),
        ("x" * (CHARACTERS_MAX + 1), f"found {CHARACTERS_MAX + 1} bytes, at most {CHARACTERS_MAX}"),
        (
            f"scene: 0x{'f' * 5000}",
            "found the number 0xffffffffffffffffff… of 5002 digits, expected at most 100",
        ),
        ("a: !!bool x", "line 1: found the tag 'tag:yaml.org,2002:bool', expected none"),
        ('a: !!int ""', "line 1: found the tag 'tag:yaml.org,2002:int', expected none"),
        ('a: !!float "_"', "line 1: found the tag 'tag:yaml.org,2002:float', expected none"),
        ("a: !!timestamp x", "line 1: found the tag 'tag:yaml.org,2002:timestamp', expected none"),
        ("a: [! x]", "line 1: found the tag '!', expected none"),
        (f"a:\n  1{':1' * 400}.5", "line 2: found '1:1:1:1:1:1:"),
        (f"actions: 1{':1' * 3000}", "line 1: found '1:1:1:1:1:1:"),
        ("2001-01-01: 2", "actions: Field required"),
        ("", "(whole file): Input should be a valid dictionary"),
    ],
    ids=[
        "bomb",
        "code",
        "deep lists",
        "deep maps",
        "long number",
        "cut",
        "nul",
        "long",
        "hexadecimal",
        "no boolean",
        "no integer",
        "no float",
        "no time",
        "bare tag",
        "float in base 60",
        "integer in base 60",
        "dates",
        "empty",
    ],
)
def test_yaml_beyond_data_is_refused_quickly(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    began = time.process_time()
    assert refused(written(tmp_path, text)).startswith(message)
    assert time.process_time() - began < 30
    assert not (tmp_path / "escaped").exists()


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        ({"scale": 0.0, "clip": [[-1.0, 1.0]] * 12}, "actions.0.scale: found 0"),
        ({"clip": [[-1.0, 1.0]]}, "actions.0.clip: found 1, expected 12"),
        ({"scale": [0.5] * 2}, "actions.0.scale: found 2, expected 12"),
    ],
)
def test_scales_and_bounds_that_do_not_fit_are_refused(tmp_path, edit, words):
    data = anymal()
    data["actions"][0] |= edit
    assert words in refused(written(tmp_path, data))


def test_a_period_out_of_bounds_is_refused(tmp_path):
    data = anymal()
    data["scene"]["dt"] = 1e-320
    assert "scene.dt" in refused(written(tmp_path, data))


def test_a_scale_below_zero_exchanges_the_bounds(tmp_path):
    data = anymal()
    data["actions"][0] |= {"scale": -0.5, "offset": 0.0, "clip": [[-1.0, 1.0]] * 12}
    assert read_descriptor(written(tmp_path, data), 48)["action"]["clip"] == [-2.0, 2.0]
