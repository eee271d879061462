import json
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings

from deploy.policy.compatibility import check_contract
from deploy.policy.contract import TEXT_MAX, Contract, Observed
from deploy.policy.contract_action import ActionSpec
from deploy.sources.catalogue import SOURCES
from robots.errors import ContractError
from robots.motors.drive_gains import drive_gains
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm
from support.contracts import NAMES, SWAPPED, arm_contract, contracts, term
from support.modes import mode_contract
from support.planar import PLANAR4, arm_with_wheel, wheel_contract
from support.quadruped import QUADRUPED, quadruped_contract


@settings(max_examples=200)
@given(contracts())
@pytest.mark.slow
def test_json_keeps_every_bit(contract):
    back = Contract.from_json(contract.to_json(), "x.onnx")
    assert back == contract
    assert back.to_json() == contract.to_json()
    assert back.observation_size == sum(len(t.scale) * t.history for t in contract.observation)


def test_observed_statistics_have_the_size_of_the_observation():
    seen = Observed(mean=(0.1,) * 30, deviation=(0.3,) * 30)
    contract = arm_contract(observed=seen)
    assert Contract.from_json(contract.to_json(), "here").observed == seen
    check_contract(contract, SPEC, "here")
    for short in ({"mean": (0.1,) * 29}, {"deviation": (0.3,) * 31}):
        with pytest.raises(ValueError, match=r"observed: found (29|31) numbers, expected 30"):
            arm_contract(observed=seen.model_copy(update=short))


def test_the_arms_contract_fits_the_arm():
    contract = arm_contract()
    assert (contract.observation_size, contract.action_size) == (30, 6)
    check_contract(contract, SPEC, "x.onnx")


def edited(path, value):
    """The arm's contract as JSON with one value changed; `...` removes it."""
    data = json.loads(arm_contract().to_json())
    place = data
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return json.dumps(data)


BAD_FIELDS = {
    "unknown key": (["gains"], 1, "gains: Extra inputs are not permitted, found 1"),
    "missing key": (["task"], ..., "task: Field required"),
    "other format": (["format"], 2, "format: Input should be 1, found 2"),
    "number as text": (["policy_hz"], "50", "policy_hz: Input should be a valid integer, found '50'"),
    "number as truth": (
        ["action", "leash_rad"],
        True,
        "action.leash_rad: Input should be a valid number, found True",
    ),
    "rate of zero": (["policy_hz"], 0, "policy_hz: Input should be greater than or equal to 1, found 0"),
    "rate no divisor": (["policy_hz"], 60, "policy_hz 60 does not divide control_hz 200"),
    "scale of zero": (
        ["observation", 0, "scale"],
        [0.0] * 6,
        "observation.0.scale.0: Input should be greater than 0",
    ),
    "scale too short": (
        ["observation", 0, "scale"],
        [1.0],
        "'joint_position': scale has 1 numbers, size is 6",
    ),
    "scale NaN": (
        ["action", "scale", 2],
        math.nan,
        "action.scale.2: Input should be a finite number, found nan",
    ),
    "scale infinite": (
        ["action", "scale", 2],
        math.inf,
        "action.scale.2: Input should be a finite number, found inf",
    ),
    "action scale short": (["action", "scale"], [1.0], "scale has 1 numbers, size is 6"),
    "clip reversed": (["action", "clip"], [1.0, -1.0], "low 1.0 is not below high -1.0"),
    "unknown mode": (
        ["action", "mode"],
        "current",
        "action.mode: Input should be 'position_increment', 'position', 'velocity' or 'torque', found 'current'",
    ),
    "unknown source": (["observation", 3, "source"], "base_velocity", "found 'base_velocity'"),
    "unit of another": (
        ["observation", 1, "unit"],
        "deg/s",
        "are 'joint' and 'deg/s', expected 'joint' and 'rad/s'",
    ),
    "frame of another": (
        ["observation", 3, "frame"],
        "joint",
        "are 'joint' and 'm', expected 'world' and 'm'",
    ),
    "term twice": (
        ["observation", 1, "name"],
        "joint_position",
        "observation: terms named twice: joint_position",
    ),
    "no term": (["observation"], [], "observation: Tuple should have at least 1 item"),
    "size too large": (
        ["observation", 0, "size"],
        10**9,
        "observation.0.size: Input should be less than or equal to 4096",
    ),
    "history too long": (["observation", 0, "history"], 4096, "observation: 24600 numbers, at most 4096"),
    "digest cut": (["robot_digest"], "abc", "robot_digest: String should match pattern"),
    "robot is a path": (["robot"], "../arm6", "robot: String should match pattern"),
}


@pytest.mark.parametrize(("path", "value", "message"), BAD_FIELDS.values(), ids=BAD_FIELDS)
def test_a_bad_field_is_named(path, value, message):
    with pytest.raises(ContractError) as caught:
        Contract.from_json(edited(path, value), "x.onnx")
    assert str(caught.value).startswith("x.onnx: ")
    assert message in str(caught.value)


NOT_JSON = {
    "empty": ("", "x.onnx: not valid JSON: Expecting value"),
    "cut": ('{"format": 1', "x.onnx: not valid JSON: Expecting ',' delimiter"),
    "too deep": ("[" * 10_000, "x.onnx: found JSON nested 10000 deep, expected at most 64"),
    "huge integer": (
        "9" * 5000,
        f"x.onnx: found the number {'9' * 20}… of 5000 digits, expected at most 100",
    ),
    "too long": (
        " " * (TEXT_MAX + 1),
        f"x.onnx: found {TEXT_MAX + 1} characters of JSON, expected at most {TEXT_MAX}",
    ),
    "a list": ("[]", "x.onnx: (whole file): Input should be a valid dictionary"),
}


@pytest.mark.parametrize(("text", "message"), NOT_JSON.values(), ids=NOT_JSON)
def test_malformed_contract_is_refused(text, message):
    with pytest.raises(ContractError) as caught:
        Contract.from_json(text, "x.onnx")
    assert str(caught.value).startswith(message)


OTHER = ("hip", *NAMES[1:])
ESCAPES = ("\x1b[2J",) * 6  # what would clear the terminal is shown, not sent


def misfits():
    five = ActionSpec(mode="position_increment", size=5, scale=(0.05,) * 5, clip=(-1.0, 1.0), leash_rad=0.3)
    yield {"robot": "planar3"}, ["robot: found 'planar3', expected 'arm6'"]
    yield (
        {"robot_digest": "0" * 64},
        [
            f"robot_digest: found {'0' * 64}, expected {SPEC.digest} of {SPEC.folder}: that has changed since the"
            " policy was exported or imported: do it again"
        ],
    )
    yield {"control_hz": 100}, ["control_hz: found 100 Hz, expected 200 Hz"]
    yield (
        {"joint_names": SWAPPED},
        [
            "joint_names: the right joints in another order: "
            f"found [{', '.join(SWAPPED)}], expected [{', '.join(NAMES)}]"
        ],
    )
    yield {"joint_names": OTHER}, [f"joint_names: found [{', '.join(OTHER)}], expected [{', '.join(NAMES)}]"]
    yield (
        {"joint_names": ESCAPES},
        [f"joint_names: found {ESCAPES!r}, expected [{', '.join(NAMES)}]"],
    )
    yield (
        {"observation": (term("joint_position", 5), term("tool_position", 2))},
        [
            "observation.joint_position.size: found 5, expected 6 for joint_position",
            "observation.tool_position.size: found 2, expected 3 for tool_position",
        ],
    )
    yield (
        {"action": five},
        [
            "observation.last_action.size: found 6, expected 5 for last_action",
            "action.size: found 5, expected 6, one for each joint",
        ],
    )


HAS = "manipulability, self_collision, tool, workspace"


def test_fixed_base_has_no_floating_base_terms():
    sources = {name: source for name, source in SOURCES.items() if "floating_base" in source.needs}
    observation = tuple(term(name, source.size) for name, source in sources.items())
    with pytest.raises(ContractError) as caught:
        check_contract(arm_contract(observation=observation, task="velocity"), SPEC, "x.onnx")
    assert str(caught.value).splitlines() == [
        f"x.onnx: task: found 'velocity', which needs [floating_base]; arm6 has {HAS}",
        *[
            f"x.onnx: observation.{name}.source: {name} needs floating_base; arm6 has {HAS}"
            for name in sources
        ],
    ]


POSITION = {"mode": "position", "size": 6, "scale": (0.5,) * 6, "offset": (0.1,) * 6, "clip": (-9.0, 9.0)}


def test_gains_come_with_the_policy():
    kp = tuple((0.95 * drive_gains(SPEC).kp).tolist())
    action = ActionSpec(**POSITION, kp=kp, kd=tuple(drive_gains(SPEC).kd.tolist()))
    check_contract(arm_contract(action=action), SPEC, "x.onnx")
    np.testing.assert_array_equal(action.gains.kp, kp)
    assert ActionSpec(**POSITION).gains is None


def test_a_wheel_needs_the_limits_of_torque_mode(tmp_path):
    """Without stiffness a joint moves as the nominal model says, less well than by a stiff drive."""
    folder = arm_with_wheel(tmp_path)
    spec = load_robot(folder)
    check_contract(wheel_contract(spec), spec, "x.onnx")
    text = (folder / "robot.toml").read_text().replace('"velocity", "torque"]', '"velocity"]')
    (folder / "robot.toml").write_text(re.sub("torque_mode = .*\n", "", text))
    spec = load_robot(folder)
    with pytest.raises(ContractError) as caught:
        check_contract(wheel_contract(spec), spec, "x.onnx")
    expected = "expected above 0: joints.wrist_roll of planar4 has no torque_mode"
    assert str(caught.value) == f"x.onnx: action.kp: found 0, {expected}"


def test_a_joint_with_ends_has_stiffness():
    """An adversary threw such joints beyond their speed limits."""
    with pytest.raises(ContractError) as caught:
        check_contract(wheel_contract(PLANAR4), PLANAR4, "x.onnx")
    expected = "expected above 0: joints.wrist_roll of planar4 has ends, unlike a wheel"
    assert str(caught.value) == f"x.onnx: action.kp: found 0, {expected}"


def test_a_robot_with_a_base_has_no_joint_without_stiffness():
    n = QUADRUPED.n
    action = ActionSpec(
        mode="velocity", size=n, scale=(1.0,) * n, clip=None, kp=(0.0, *(80.0,) * (n - 1)), kd=(2.0,) * n
    )
    with pytest.raises(ContractError, match=r"action\.kp: found 0, expected above 0 on a robot with a base"):
        check_contract(quadruped_contract(action=action), QUADRUPED, "x.onnx")


def test_gait_phases_share_one_period():
    terms = [term("gait_phase", 2, period_s=s).model_copy(update={"name": f"{s}"}) for s in (0.8, 0.9)]
    assert arm_contract(observation=tuple(terms[:1])).period_s == 0.8
    with pytest.raises(ValueError, match=r"period_s: found \[0\.8, 0\.9\], expected the same for all"):
        arm_contract(observation=tuple(terms))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"offset": None}, "offset: found none in mode 'position'"),
        ({"leash_rad": 0.3}, "leash_rad: found one in mode 'position'"),
        ({"offset": (0.1,) * 5}, "offset has 5 numbers, size is 6"),
        ({"kp": (1.0,) * 6}, "found one of kp and kd, expected both or none"),
        ({"kp": (1.0,) * 6, "kd": (1.0,) * 4}, "kd has 4 numbers, size is 6"),
        ({"mode": "position_increment", "leash_rad": 0.3}, "offset: found one in mode"),
        ({"mode": "velocity"}, "offset: found one in mode 'velocity'"),
        (
            {"mode": "torque", "offset": None, "leash_rad": 0.3},
            "leash_rad: found one in mode 'torque'",
        ),
        ({"change_max": (0.1,) * 5}, "change_max has 5 numbers, size is 6"),
        (
            {"mode": "position_increment", "offset": None, "leash_rad": 0.3, "change_max": (0.1,) * 6},
            "change_max: found one in mode 'position_increment', where scale bounds it",
        ),
        ({"mode": "velocity", "offset": None, "kp": (0.0,) * 6, "kd": (0.0,) * 6}, "kd.0\n.*greater than 0"),
        (
            {"kp": (1.0, 0.0, 1.0, 1.0, 1.0, 1.0), "kd": (1.0,) * 6},
            "kp: found 0 in mode 'position', expected above 0: drives follow angles",
        ),
        (
            {"mode": "torque", "offset": None, "kp": (1.0,) * 6, "kd": (1.0,) * 6},
            "kp: found some in mode 'torque', expected none: they are 0",
        ),
    ],
)
def test_action_fields_belong_to_one_mode(changes, message):
    with pytest.raises(ValueError, match=message):
        ActionSpec(**{**POSITION, **changes})


def test_only_a_gait_has_a_period():
    with pytest.raises(ValueError, match=r"period_s: found 0\.8, expected it of gait_phase alone"):
        term("joint_position", 6, period_s=0.8)
    with pytest.raises(ValueError, match="period_s: found none, expected s of one gait"):
        term("gait_phase", 2, period_s=None)


@pytest.mark.parametrize(("changes", "lines"), list(misfits()))
def test_every_mismatch_is_reported_at_once(changes, lines):
    with pytest.raises(ContractError) as caught:
        check_contract(arm_contract(**changes), SPEC, "x.onnx")
    assert str(caught.value) == "\n".join(f"x.onnx: {line}" for line in lines)


def test_sensor_missing_on_the_robot_is_named(tmp_path):
    """Each term that needs it is named."""
    folder = copy_of_arm(tmp_path, toml=[(r"(?s)\[sensors\.goal\].*?(?=# Drives)", "")])
    blind = load_robot(folder)
    assert "goal" not in blind.sensors
    with pytest.raises(ContractError) as caught:
        check_contract(arm_contract(robot_digest=blind.digest), blind, "policy.onnx")
    assert str(caught.value).splitlines() == [
        f"policy.onnx: observation.{name}.source: {name} needs a sensor of kind goal; arm6 has encoder, current,"
        " temperature, force"
        for name in ("goal_from_tool", "goal_torque")
    ]


def test_a_distance_from_the_target_needs_targets_that_are_angles():
    action = mode_contract("velocity").action
    contract = arm_contract(observation=(term("target_offset", 6),), action=action)
    with pytest.raises(
        ContractError, match=r"target_offset is a difference of angles, .* action\.mode 'velocity'"
    ):
        check_contract(contract, SPEC, "x.onnx")
