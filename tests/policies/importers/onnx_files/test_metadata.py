import pytest

from policies.importers.onnx_files.foreign_onnx import read_onnx
from policies.importers.onnx_files.metadata import known_from
from robots.errors import ContractError
from support.importers.onnx_metadata import MJLAB, graph

JOINTS = ["FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"]
POSE = [0.1, 0.9, -1.8]
MOTION = {
    "run_path": "local",
    "joint_names": "FR_hip_joint,FR_thigh_joint,FR_calf_joint",
    "joint_stiffness": "20.900,20.900,20.900",
    "joint_damping": "1.330,1.330,1.330",
    "default_joint_pos": "0.100,0.900,-1.800",
    "command_names": "motion",
    "observation_names": (
        "command,motion_anchor_pos_b,motion_anchor_ori_b,base_lin_vel,base_ang_vel,joint_pos,joint_vel,actions"
    ),
    "action_scale": "0.373,0.373,0.373",
}
"""The same of mjlab 1.4.0 for a motion to be tracked, as BeyondMimic writes it too."""
PUBLISHED = {
    "observation_terms_clip": ",".join(["[-inf, inf]"] * 7),
    "observation_terms_history_length": "5.000,5.000,5.000,5.000,5.000,5.000,5.000",
    "observation_terms_scale": "1.000,1.000,1.000,1.000,1.000,1.000,1.000",
    "observation_terms_flatten_history_dim": "1.000,1.000,1.000,1.000,1.000,1.000,1.000",
    "command_names": "twist",
    "observation_names": "base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,command",
}
"""Of a Unitree G1, as mujocolab/mjlab pull request 903 shows it: lists as Python writes them."""

HOLOSOMA = {
    "dof_names": '["left_hip_pitch_joint", "left_knee_joint", "left_ankle_pitch_joint"]',
    "kp": "[40.179, 99.098, 28.501]",
    "kd": "[2.558, 6.309, 1.814]",
    "action_scale": "0.25",
    "command_ranges": "null",
    "observation_layout": (
        '[{"group": "actor_obs", "name": "actions", "func": '
        '"holosoma.managers.observation.terms.wbt:actions", "dim": 3, "history_length": 5, "scale": '
        '1.0, "clip": null, "params": {}}, {"group": "actor_obs", "name": "base_ang_vel", "func": '
        '"holosoma.managers.observation.terms.wbt:base_ang_vel", "dim": 3, "history_length": 5, '
        '"scale": 0.25, "clip": null, "params": {}}, {"group": "actor_obs", "name": "dof_pos", '
        '"func": "holosoma.managers.observation.terms.wbt:dof_pos", "dim": 3, "history_length": 5, '
        '"scale": 1.0, "clip": null, "params": {}}, {"group": "actor_obs", "name": "dof_vel", '
        '"func": "holosoma.managers.observation.terms.wbt:dof_vel", "dim": 3, "history_length": 5, '
        '"scale": 0.05, "clip": [-18.0, 200.0], "params": {}}, {"group": "actor_obs", "name": '
        '"gravity", "func": "holosoma.managers.observation.terms.wbt:gravity_vector", "dim": 3, '
        '"history_length": 5, "scale": 1.0, "clip": null, "params": {}}]'
    ),
    "observation_clip": "100.0",
    "experiment_config": (
        '{"simulator": {"config": {"sim": {"fps": 200, "control_decimation": 4, "substeps": 1, '
        '"physx": {"solver_type": 1, "num_position_iterations": 8, "num_velocity_iterations": 4, '
        '"num_threads": 4, "enable_dof_force_sensors": false, "bounce_threshold_velocity": 0.5}, '
        '"render_mode": "human", "render_interval": 1, "max_episode_length_s": 20.0, '
        '"kinematic_playback": false}}}, "robot": {"control": {"control_type": "P", "stiffness": '
        '{"hip_pitch": 40.179, "knee": 99.098, "ankle_pitch": 28.501}, "damping": {"hip_pitch": '
        '2.558, "knee": 6.309, "ankle_pitch": 1.814}, "action_scale": 0.25, "action_clip_value": '
        '100.0, "clip_actions": true, "clip_torques": true, '
        '"action_scales_by_effort_limit_over_p_gain": false}, "init_state": {"pos": [0.0, 0.0, 0.8], '
        '"rot": [0.0, 0.0, 0.0, 1.0], "lin_vel": [0.0, 0.0, 0.0], "ang_vel": [0.0, 0.0, 0.0], '
        '"default_joint_angles": {"left_hip_pitch_joint": -0.312, "left_knee_joint": 0.669, '
        '"left_ankle_pitch_joint": -0.363}}}, "action": {"terms": {"joint_control": {"func": '
        '"holosoma.managers.action.terms.joint_control:JointPositionActionTerm", "params": {}, '
        '"scale": 1.0, "clip": null}}}}'
    ),
    "iteration": "1000",
}
"""What attach_onnx_metadata of holosoma 0.0.3 wrote of its own records, for three joints of a leg."""


def terms(metadata, source="a.onnx"):
    return {term["name"]: term for term in known_from(metadata, source)["observation"]}


def test_the_metadata_of_mjlab_fills_the_contract():
    known = known_from(MJLAB, "a.onnx")
    assert known["joint_names"] == JOINTS
    assert known["task"] == "velocity"
    assert (known["layout"], known["frames"], known["fill"]) == ("by_term", "oldest_first", "first")
    assert known["action"] == {
        "mode": "position",
        "offset": POSE,
        "multiply": [0.373, 0.373, 0.24],
        "kp": [20.9, 20.9, 38.3],
        "kd": [1.33, 1.33, 2.44],
    }
    assert known.keys().isdisjoint({"robot", "policy_hz"})
    assert [term["name"] for term in known["observation"]] == MJLAB["observation_names"].split(",")


def test_each_term_has_its_source_offset_factor_bounds_and_history():
    found = terms(MJLAB)
    assert found["joint_pos"] == {
        "name": "joint_pos",
        "source": "joint_position",
        "offset": POSE,
        "multiply": 1.0,
        "clip": "none",
        "clip_first": True,
        "history": 5,
    }
    assert found["joint_vel"]["clip"] == [-100.0, 100.0]
    assert found["joint_vel"]["multiply"] == 0.05
    assert found["actions"]["clip"] == [-1e30, 1.0]
    assert found["command"] == {
        "name": "command",
        "source": "velocity_command",
        "offset": "none",
        "multiply": [2.0, 2.0, 0.25],
        "clip": "none",
        "clip_first": True,
        "history": 1,
    }
    assert found["height_scan"].keys().isdisjoint({"source", "offset"})  # no word of ours


def test_fields_missing_in_older_files_stay_open():
    known = known_from(MOTION, "a.onnx")
    assert known.keys() == {"joint_names", "observation", "action"}
    assert terms(MOTION)["joint_pos"] == {"name": "joint_pos", "source": "joint_position", "offset": POSE}
    assert terms(MOTION)["command"] == {"name": "command"}  # of a motion, not of a velocity


def test_lists_inside_a_list_may_have_brackets_and_commas():
    found = terms(PUBLISHED | {"observation_terms_clip": ",".join(["[-inf, inf]"] * 5 + ["(-1.0, 1.0)"] * 2)})
    assert [term["clip"] for term in found.values()] == ["none"] * 5 + [[-1.0, 1.0]] * 2
    assert {term["history"] for term in terms(PUBLISHED).values()} == {5}
    assert "offset" not in found["joint_pos"]  # no default pose


def test_histories_of_beyondmimic_are_found_under_their_own_name():
    lengths = "1.000,1.000,1.000,10.000,10.000,10.000,10.000,10.000"
    known = known_from(MOTION | {"observation_history_lengths": lengths}, "a.onnx")
    assert [term["history"] for term in known["observation"]] == [1, 1, 1, 10, 10, 10, 10, 10]
    assert known["layout"] == "by_term"


def test_one_action_scale_may_hold_for_all_joints():
    assert known_from(MJLAB | {"action_scale": "0.5"}, "a.onnx")["action"]["multiply"] == 0.5


def test_non_positive_gains_and_factors_are_ignored():
    """mjlab issue 347: drives that are not the simulator's own are written as 1.000 and -0.000."""
    ideal = {"joint_stiffness": "1.000,1.000,1.000", "joint_damping": "-0.000,-0.000,-0.000"}
    known = known_from(MJLAB | ideal | {"action_scale": "0.373,0.000,0.373"}, "a.onnx")
    assert known["action"] == {"mode": "position", "offset": POSE}


def test_joints_without_gains_are_observed_and_left_open():
    """mjlab names every joint, but gains and scales only of those that have drives."""
    pose = {"joint_names": MJLAB["joint_names"] + ",finger", "default_joint_pos": "0.100,0.900,-1.800,0.000"}
    known = known_from(MJLAB | pose, "a.onnx")
    assert known["joint_names"] == [*JOINTS, "finger"]
    assert known["action_joints"] == "?"
    assert known["action"].keys() == {
        "mode",
        "multiply",
        "kp",
        "kd",
    }  # its pose is that of joints still unknown
    assert terms(MJLAB | pose)["joint_pos"]["offset"] == [*POSE, 0.0]


def test_file_without_metadata_fills_nothing():
    assert known_from({}, "a.onnx") == {}
    assert known_from({"description": "a, b", "joint": "x"}, "a.onnx") == {}


@pytest.mark.parametrize(
    ("key", "value", "complaint"),
    [
        # a joint that is not actuated, as mjlab 1.6.0 wrote it
        (
            "joint_names",
            "FR_hip_joint,FR_thigh_joint,FR_calf_joint,passive_joint",
            "'default_joint_pos': found '0.100,0.900,-1.800', expected 4 entries",
        ),
        ("joint_damping", "1.330,1.330", "found '1.330,1.330', expected 3 entries"),
        ("joint_stiffness", ",".join(["1.000"] * 4), "expected 3 entries"),
        ("joint_names", "a,,b", "found 'a,,b', expected at most 4096 entries"),
        ("joint_names", '["a", "b", "c"]', "expected a name"),
        ("joint_names", ",".join(["a"] * 5000), "expected at most 4096 entries"),
        ("joint_names", "a," * (1 << 20), "expected at most 4096 entries"),
        ("default_joint_pos", "0.1,nan,0.1", "found 'nan', expected at most 4096 numbers"),
        ("default_joint_pos", "0.1,inf,0.1", "expected one finite number"),
        ("default_joint_pos", "0.1,zero,0.1", "found 'zero', expected numbers"),
        ("action_scale", "0.1,0.2", "expected 3 entries"),
        ("observation_terms_clip", ",".join(["1;-1"] * 8), "found [1.0, -1.0], expected low and high"),
        ("observation_terms_history_length", ",".join(["2.5"] * 8), "('base_lin_vel', 2.5, 1.0)"),
        ("observation_terms_history_length", ",".join(["1e9"] * 8), "expected a length of 0 to 4096"),
        ("observation_terms_flatten_history_dim", ",".join(["0.000"] * 8), "('joint_pos', 5.0, 0.0)"),
    ],
)
def test_invalid_metadata_is_refused_in_one_line(key, value, complaint):
    with pytest.raises(ContractError) as e:
        known_from(MJLAB | {key: value}, "a.onnx")
    assert complaint in str(e.value)
    assert str(e.value).startswith("a.onnx: metadata '")
    assert "\n" not in str(e.value)
    assert len(str(e.value)) < 500


def test_the_metadata_of_holosoma_fills_the_contract():
    known = known_from(HOLOSOMA, "a.onnx")
    pose = [-0.312, 0.669, -0.363]
    assert known["joint_names"] == ["left_hip_pitch_joint", "left_knee_joint", "left_ankle_pitch_joint"]
    assert known["policy_hz"] == 50
    assert (known["layout"], known["frames"], known["fill"]) == ("by_term", "oldest_first", "zeros")
    assert known["action"] == {
        "mode": "position",
        "offset": pose,
        "clip": [-100.0, 100.0],
        "multiply": 0.25,
        "kp": [40.179, 99.098, 28.501],
        "kd": [2.558, 6.309, 1.814],
    }
    found = terms(HOLOSOMA)
    assert list(found) == ["actions", "base_ang_vel", "dof_pos", "dof_vel", "gravity"]
    assert found["dof_pos"]["offset"] == pose
    assert found["dof_vel"] == {
        "name": "dof_vel",
        "source": "joint_velocity",
        "offset": "none",
        "multiply": 0.05,
        "clip": [-18.0, 100.0],  # of the term and of all
        "clip_first": False,
        "history": 5,
    }
    assert "source" not in found["gravity"]  # of the world, not of the base


def test_older_files_of_holosoma_fill_less():
    known = known_from({key: HOLOSOMA[key] for key in ("dof_names", "kp", "kd")}, "a.onnx")
    assert known.keys() == {"joint_names", "action"}
    assert known["action"].keys() == {"kp", "kd"}


@pytest.mark.parametrize(("before", "after"), [('"P"', '"T"'), (":JointPosition", ":FixedJointPosition")])
def test_non_position_actions_of_holosoma_stay_open(before, after):
    config = HOLOSOMA["experiment_config"].replace(before, after)
    assert config != HOLOSOMA["experiment_config"]
    action = known_from(HOLOSOMA | {"experiment_config": config}, "a.onnx")["action"]
    assert action.keys() == {"multiply", "kp", "kd"}


@pytest.mark.parametrize(
    ("key", "value", "complaint"),
    [
        ("kp", "[1.0, 2.0]", "'kp': found 2 numbers, expected 3"),
        ("kp", "[1.0, NaN, 2.0]", "kp.1: Input should be a finite number, found nan"),
        ("dof_names", "left_knee", "'dof_names': not valid JSON"),
        ("dof_names", "[" * 10_000, "'dof_names': found JSON nested 10000 deep"),
        ("action_scale", '["a"]', "action_scale."),
        ("dof_names", '["left_hip_pitch_joint", "left_knee_joint", "x"]', "found none for 'x'"),
        ("experiment_config", '{"robot": {}}', "control_type"),
        ("observation_clip", "-1", "observation_clip: Input should be greater than 0, found -1"),
    ],
)
def test_invalid_metadata_of_holosoma_is_refused(key, value, complaint):
    with pytest.raises(ContractError) as e:
        known_from(HOLOSOMA | {key: value}, "a.onnx")
    assert complaint in str(e.value)
    assert all(line.startswith("a.onnx: metadata") for line in str(e.value).splitlines())


def test_onnx_metadata_fill_the_template():
    written = pytest.importorskip(
        "policies.importers.contract_template", exc_type=ImportError
    ).render_template
    facts = read_onnx(graph(MJLAB), "a.onnx").facts
    assert facts.known == known_from(MJLAB, "a.onnx")
    text, still_open = written(facts, "a.onnx")
    assert 'joint_names = ["FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"]' in text
    assert still_open == 5  # robot, policy_hz, source and offset of height_scan, clip of the action
    assert read_onnx(graph({}), "a.onnx").facts.known == {}


def test_onnx_file_with_invalid_metadata_is_refused():
    with pytest.raises(ContractError, match=r"a\.onnx: metadata 'action_scale'"):
        read_onnx(graph(MJLAB | {"action_scale": "x"}), "a.onnx")
