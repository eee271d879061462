"""What the doctor sees in a file and a robot's folder: each mistake is made on purpose, in the shipped policy."""

import json

import numpy as np
import onnx
import pytest

pytest.importorskip("mujoco")

from hypothesis import given, settings
from onnx import helper, numpy_helper

from deploy.policy.policy_names import CONTRACT_KEY
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import (
    CheckResult,
    Verdict,
    failed,
    format_values,
    passed,
    summarize,
    warned,
)
from policies.doctor.checklist import CHECKS, run_check, run_checks
from robots.errors import ContractError, RobotError
from support.contracts import NAMES, SWAPPED, contracts
from support.doctor import text_of
from support.faulty_policies import (
    ailing,
    answering,
    in_another_order,
    robot_and_digest,
    without_normalizer,
    written,
)
from support.policies import metadata

pytestmark = pytest.mark.slow

N = 36


@pytest.fixture(scope="module")
def sound(shipped_policy):
    return CheckContext(shipped_policy)


@pytest.fixture
def sick(shipped_policy, tmp_path):
    """The shipped policy with a change."""
    return lambda robot=None, **how: CheckContext(ailing(shipped_policy, tmp_path, **how), robot)


def contract_of(path):
    return json.loads(metadata(onnx.load(path), CONTRACT_KEY).value)


def action(**fields):
    return lambda data: data["action"].update(fields)


@pytest.mark.parametrize("check", ["loader", "joints", "action", "gains", "rates", "sources", "protection"])
def test_the_shipped_policy_passes(sound, check):
    assert run_check(sound, check).verdict is Verdict.PASS


def test_only_the_first_of_many_are_listed():
    names, numbers = [f"j{k}" for k in range(8)], np.arange(8.0)
    assert format_values(names, numbers, 2 * numbers, unit=" rad", selection=numbers > 6) == "j7 7 of 14 rad"
    assert format_values(names, numbers, selection=np.array([3, 1])) == "j3 3, j1 1"
    assert format_values(names, numbers, unit=" A") == "j0 0, j1 1, j2 2, j3 3, j4 4, j5 5 A and 2 more"


def test_row_verdict_is_its_worst_note_and_omits_passed_ones():
    notes = [passed("fine."), warned("odd."), failed("wrong."), passed("good.")]
    assert summarize("x", notes) == CheckResult(check="x", verdict=Verdict.FAIL, text="wrong.\nodd.")
    assert summarize("x", [notes[0], notes[3]]).text == "fine.\ngood."


# ---- joints ----


def test_joints_in_another_order_are_named_with_their_places(sick):
    case = sick(contract=lambda data: data.update(joint_names=SWAPPED))
    found = text_of(case, "joints", Verdict.FAIL)
    assert found.startswith("the right joints in another order (")
    moved = [k for k in range(6) if SWAPPED[k] != NAMES[k]]
    assert all(f"{k}: {SWAPPED[k]}, not {NAMES[k]}" in found for k in moved)
    assert "joint_names: the right joints in another order" in run_check(case, "loader").text


def test_unknown_joints_get_suggestions_and_missing_joints_are_listed(sick):
    wrong = ["sholder_pan", "shoulder_lift", "elbow_joint", "wrist_1", "wrist_1", "wrist_3"]
    found = text_of(sick(contract=lambda data: data.update(joint_names=wrong)), "joints", Verdict.FAIL)
    for said in (
        "'sholder_pan', perhaps shoulder_pan",
        "'elbow_joint', perhaps elbow",
        "lacks shoulder_pan, elbow, wrist_2",
        "more than once: wrist_1",
    ):
        assert said in found


def test_network_trained_in_another_joint_order_is_suspected(sick, shipped_policy):
    """Its normalizer still knows where each joint stood."""
    order = in_another_order([2, 0, 1, 3, 5, 4], contract_of(shipped_policy)["observation"])
    found = text_of(sick(graph=order), "joints", Verdict.WARN)
    assert "in training the mean of shoulder_lift was 1.24 rad, outside its range -2.4 to -0.3" in found
    assert "which fits shoulder_pan or elbow or wrist_3" in found


def test_joint_order_is_unknown_without_training_statistics(sick):
    found = text_of(
        sick(graph=without_normalizer, contract=lambda data: data.update(observed=None)),
        "joints",
        Verdict.WARN,
    )
    assert "so only the simulation shows whether the network has this order" in found


# ---- scale, offset, gains ----


def test_doubled_scale_exceeds_joint_limits(sick):
    found = text_of(sick(contract=action(scale=[0.1] * 6)), "action", Verdict.WARN)
    assert "an action of 1 asks for shoulder_pan 5 of 3.14, " in found
    assert "at 50 Hz: compare scale and rate with training" in found


@pytest.mark.parametrize(("scale", "verdict"), [(3.0, Verdict.FAIL), (0.001, Verdict.WARN)])
def test_a_scale_in_another_unit_is_named(sick, scale, verdict):
    found = text_of(sick(contract=action(scale=[0.05] * 5 + [scale])), "action", verdict)
    assert f"wrist_3 {50 * scale:.3g} of 3.14 rad/s" in found
    assert "elbow" not in found


def positions(offset, scale=0.5, clip=(-1.0, 1.0)):
    return action(mode="position", offset=offset, scale=[scale] * 6, leash_rad=None, clip=clip)


def test_an_offset_outside_the_working_range_is_named(sick):
    found = text_of(sick(contract=positions([0.0] * 6)), "action", Verdict.FAIL)
    assert "an action of 0 asks for shoulder_lift 0, elbow 0, wrist_2 0 rad, outside the working" in found
    assert "an action of 1 or -1 sends wrist_1 beyond the working range" in found


def test_scales_are_compared_with_the_working_range(sick):
    home = [0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]
    assert run_check(sick(contract=positions(home)), "action").verdict is Verdict.PASS
    for scale, said in ((7.0, "more than the joint can"), (0.01, "almost nothing")):
        assert said in text_of(sick(contract=positions(home, scale)), "action", Verdict.WARN)
    unbounded = run_check(sick(contract=positions(home, clip=None)), "action")
    assert (unbounded.verdict, unbounded.text[:5]) == (Verdict.WARN, "clip:")


def test_gains_are_compared_with_torque_and_inertia(sick):
    found = text_of(sick(contract=action(kp=[8000.0] * 6, kd=[200.0] * 5 + [0.01])), "gains", Verdict.FAIL)
    hard, odd, ratio = found.split("\n")
    assert "is wrist_1 400 of 28, wrist_2 400 of 28, wrist_3 400 of 28 N·m: compare kp and scale" in hard
    assert "is shoulder_pan 400 of 150, shoulder_lift 400 of 150, elbow 400 of 150 N·m: compare" in odd
    assert "give a damping ratio of wrist_3 " in ratio
    assert "elbow" not in ratio


def test_gains_that_an_import_does_not_name_cannot_be_compared(sick):
    found = text_of(
        sick(contract=lambda data: data.update(trained={"imported": "ONNX"})), "gains", Verdict.WARN
    )
    assert "they cannot be compared with training" in found


def test_negative_gains_make_no_contract(sick):
    with pytest.raises(
        ContractError, match=r"action\.kp\.2: Input should be greater than or equal to 0, found -60"
    ):
        sick(contract=action(kp=[60.0, 60.0, -60.0, 60.0, 60.0, 60.0], kd=[2.0] * 6))


# ---- rates ----


def test_different_control_and_training_rates_are_both_named(sick):
    case = sick(contract=lambda data: data.update(control_hz=500, trained={"step_dt": "0.01", "seed": "x"}))
    found = text_of(case, "rates", Verdict.FAIL)
    assert "made for control at 500 Hz, arm6 has 200 Hz" in found
    assert "policy_hz is 50, training has step_dt: 100 Hz" in found
    agreed = text_of(
        sick(contract=lambda data: data.update(trained={"policy_hz": "50"})), "rates", Verdict.PASS
    )
    assert "as in training" in agreed
    imported = text_of(
        sick(contract=lambda data: data.update(trained={"imported": "ONNX"})), "rates", Verdict.WARN
    )
    assert "the rate of training is not in the file: ask" in imported


def test_a_sensor_slower_than_the_policy_is_named(sick, tmp_path):
    robot, digest = robot_and_digest(tmp_path, toml=[('(unit = "rad"\n)rate_hz = 200', r"\1rate_hz = 40")])
    found = text_of(sick(robot, contract=digest), "rates", Verdict.WARN)
    assert "encoder has 40 new readings per second, the policy runs at 50 Hz" in found


# ---- sensors, protection ----


def test_unmeasured_term_is_named_with_the_missing_sensor(sick):
    def ask(data):
        data["observation"][2].update(source="base_linear_velocity", frame="base", unit="m/s")

    found = text_of(sick(contract=ask), "sources", Verdict.FAIL)
    assert "tool_position (base_linear_velocity) needs gyro and accelerometer, arm6 has" in found
    assert "train without the term" in found


def test_an_actor_that_leans_on_exteroceptive_sources_is_named(sound):
    found = text_of(sound, "proprioception", Verdict.WARN)
    assert "9 of 36 numbers are exteroceptive: goal_from_tool (goal_from_tool), goal_torque" in found
    assert "Prefer proprioception for the actor" in found


def test_an_actor_of_the_body_alone_is_not_warned(sick):
    def blind(data):
        for each in data["observation"]:
            if each["source"] == "goal_from_tool":
                each.update(source="tool_position")
            if each["source"] == "goal_torque":
                each.update(source="joint_velocity", unit="rad/s")

    assert run_check(sick(contract=blind), "proprioception").verdict is Verdict.PASS


def test_a_robot_without_the_camera_that_the_policy_needs(sick, tmp_path):
    camera = r'(?s)\[sensors\.goal\].*?calibrated to the arm\'s base"\n'
    robot, digest = robot_and_digest(tmp_path, toml=[(camera, "")])
    found = text_of(sick(robot, contract=digest), "sources", Verdict.FAIL)
    assert "goal_from_tool (goal_from_tool) needs goal, arm6 has" in found
    assert "goal_torque (goal_torque) needs goal" in found


BARE = {
    "torque": ('actuatorfrcrange="-150 150" ', "", "torque is not limited"),
    "capsules": (
        '<geom group="3" condim="1"',
        '<geom group="3" condim="1" contype="0" conaffinity="0"',
        "self-collisions are not detected",
    ),
    "windings": ('thermal="1.0 40 0 0.0039 25 25"', "", "motor temperatures are not estimated"),
}


@pytest.mark.parametrize(("old", "new", "said"), BARE.values(), ids=BARE)
def test_a_robot_without_a_guard_is_named(sick, tmp_path, old, new, said):
    robot, digest = robot_and_digest(tmp_path, xml=[(old, new)])
    found = text_of(sick(robot, contract=digest), "protection", Verdict.FAIL)
    assert said in found
    assert str(robot) in found


# ---- the loader ----


def test_changed_robot_and_changed_network_are_both_named(shipped_policy, tmp_path):
    robot, _ = robot_and_digest(tmp_path, toml=[("q_max = 1.3", "q_max = 1.4")])
    model = onnx.load(shipped_policy)
    bias = next(tensor for tensor in model.graph.initializer if tensor.name == "mlp.4.bias")
    bias.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(bias) + np.float32(0.1), "mlp.4.bias"))
    (tmp_path / "other.onnx").write_bytes(model.SerializeToString())
    found = run_check(CheckContext(tmp_path / "other.onnx", robot), "loader")
    assert found.verdict is Verdict.FAIL
    assert "robot_digest: arm6 has changed since training" in found.text
    assert "golden pairs: found a deviation of 0.1 at batch 1" in found.text


def test_all_loader_errors_are_listed_at_once(sick):
    case = sick("arm6", contract=lambda data: data.update(robot="leg", joint_names=SWAPPED, control_hz=400))
    with pytest.raises(RobotError, match="--robot leg: no such folder"):
        CheckContext(case.path)
    found = run_check(case, "loader")
    for said in ("robot: found 'leg', expected 'arm6'", "joint_names: ", "control_hz: found 400 Hz"):
        assert said in found.text


def test_control_characters_in_names_are_escaped(sick):
    evil = "\x1b]0;gone\x07"

    def rename(data):
        data["observation"][0]["name"] = data["joint_names"][0] = data["joint_names"][1] = evil

    case = sick(contract=rename)
    for check in ("loader", "joints", "sources"):
        said = run_check(case, check).text
        assert "gone" in said
        assert said.replace("\n", "").isprintable()


@settings(max_examples=25)
@given(contracts())
def test_every_contract_gets_all_rows(tmp_path_factory, contract):
    """However little it fits the arm, and however large its numbers."""
    w = np.ones((contract.observation_size, contract.action_size), np.float32)
    node = helper.make_node("MatMul", ["observation", "w"], ["action"])
    case = CheckContext(written(tmp_path_factory.mktemp("any"), [node], {"w": w}, contract), "arm6")
    found = {each.check: each.verdict for each in run_checks(case)}
    assert list(found) == list(CHECKS)
    assert found["loader"] is found["joints"] is found["simulation"] is Verdict.FAIL


# ---- a normalizer is found however it is written ----


def rewritten(*nodes, **tensors):
    """The bare network behind other nodes, of which the last gives "ready"."""

    def change(model):
        without_normalizer(model)
        next(node for node in model.graph.node if node.op_type == "Gemm").input[0] = "ready"
        for place, node in enumerate(nodes):
            model.graph.node.insert(place, node)
        arrays = {name: np.asarray(array) for name, array in tensors.items()}
        model.graph.initializer.extend(numpy_helper.from_array(x, name) for name, x in arrays.items())

    return change


def test_normalizer_in_the_graph_is_recognized(sound):
    observed = sound.contract.observed
    np.testing.assert_allclose(sound.normalizer.mean, observed.mean, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(sound.normalizer.deviation, observed.deviation, rtol=1e-3)


def test_normalizer_is_found_in_every_notation(sick, sound):
    mean, deviation = (np.array(x, np.float32) for x in (sound.normalizer.mean, sound.normalizer.deviation))
    order = np.random.default_rng(0).permutation(N)
    node = helper.make_node
    line = rewritten(
        node("Mul", ["observation", "slope"], ["turned"]),
        node("Add", ["turned", "shift"], ["ready"]),
        slope=1 / deviation,
        shift=-mean / deviation,
    )
    batch = rewritten(
        node("BatchNormalization", ["observation", "one", "zero", "m", "v"], ["ready"], epsilon=0.0),
        one=np.ones(N, np.float32),
        zero=np.zeros(N, np.float32),
        m=mean,
        v=deviation**2,
    )
    behind = rewritten(
        node("Gather", ["observation", "order"], ["theirs"], axis=1),
        node("Sub", ["theirs", "m"], ["less"]),
        node("Div", ["less", "d"], ["clipped"]),
        node("Clip", ["clipped", "low", "high"], ["ready"]),
        order=order,
        m=mean[order],
        d=deviation[order],
        low=np.float32(-1000),
        high=np.float32(1000),
    )
    for change in (line, batch, behind):
        found = sick(graph=change).normalizer
        np.testing.assert_allclose(found.mean, mean, rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(found.deviation, deviation, rtol=1e-3)


def test_other_nodes_are_not_taken_for_a_normalizer(sick):
    one = rewritten(helper.make_node("Mul", ["observation", "one"], ["ready"]), one=np.ones(N, np.float32))
    squared = rewritten(helper.make_node("Softmax", ["observation"], ["ready"]))
    for change in (without_normalizer, one, squared):
        assert sick(graph=change).normalizer is None


def test_normalizer_is_found_despite_a_reversed_output(sick, sound):
    turned = sick(graph=answering(helper.make_node("Neg", ["said"], ["action"])))
    np.testing.assert_array_equal(turned.normalizer.mean, sound.normalizer.mean)
