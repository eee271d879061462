"""What a short life in simulation shows the doctor: mistakes that the file alone does not."""

import json
import re
import shutil
import subprocess
import sys
from functools import partial

import numpy as np
import onnx
import pytest

pytest.importorskip("mujoco")

from onnx import helper

from deploy.policy.policy_names import CONTRACT_KEY
from policies.doctor import cli as checking
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Verdict
from policies.doctor.checklist import CHECKS, run_check, run_checks
from policies.doctor.simulation import joint_order, simulated_run, task_checks
from policies.doctor.simulation.heat_extrapolation import HeatLoad, winding_temperature
from robots.motors.motor import MotorHeat, temperatures
from robots.spec import load_robot
from support.arm6 import SPEC
from support.contracts import arm_contract
from support.doctor import text_of
from support.faulty_policies import (
    ailing,
    answering,
    in_another_order,
    louder,
    robot_and_digest,
    without_normalizer,
    written,
)
from support.paths import ROOT
from support.policies import metadata
from support.walking import PLACES, QUADRUPED, walking_contract

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sound(shipped_policy):
    """Its lives are lived once for all tests here."""
    return CheckContext(shipped_policy)


@pytest.fixture
def sick(shipped_policy, tmp_path):
    """The shipped policy with a change."""
    return lambda robot=None, **how: CheckContext(ailing(shipped_policy, tmp_path, **how), robot)


@pytest.fixture(scope="module")
def double(shipped_policy, tmp_path_factory):
    """With twice the scale of its actions."""
    twice = {"contract": lambda data: data["action"].update(scale=[0.1] * 6)}
    return CheckContext(ailing(shipped_policy, tmp_path_factory.mktemp("double"), **twice))


@pytest.fixture(scope="module")
def nervous(shipped_policy, tmp_path_factory):
    """Five times as loud: a wrong scale inside the network, or too little of a price on its actions in training."""
    return CheckContext(ailing(shipped_policy, tmp_path_factory.mktemp("nervous"), graph=louder(5.0)))


def unobserved(data):
    data["observed"] = None


def test_the_shipped_policy_passes_every_check_but_three(sound):
    """A camera tells it where its goals are, and once it asks for more than the range of a joint. Nobody told it of
    20 ms more, and it says so: half of that it takes."""
    found = {check: run_check(sound, check) for check in CHECKS}
    odd = {check: each.verdict for check, each in found.items() if each.verdict is not Verdict.PASS}
    assert odd == {"simulation": Verdict.WARN, "delay": Verdict.WARN, "proprioception": Verdict.WARN}
    assert sound.run.counts.reached.sum() == sound.run.counts.attempted.sum() == 24
    assert found["simulation"].text.startswith("asked for 1.1")
    assert "10 ms do no harm" in found["delay"].text


def test_first_target_is_within_one_action_step(sound):
    assert 0.03 < np.abs(sound.run.first_step).max() < 0.06


# ---- the normalizer ----


@pytest.mark.usefixtures("one_goal")
def test_normalizer_lost_by_the_graph_is_found(sick):
    case = sick(graph=without_normalizer)
    found = text_of(case, "normalizer", Verdict.FAIL)
    assert found.startswith(
        "training normalized its observations, but the graph has no normalizer before its first"
    )
    assert run_check(case, "simulation").verdict is Verdict.FAIL


@pytest.mark.usefixtures("one_goal")
def test_missing_normalizer_is_suspected_and_the_simulation_fails(sick):
    case = sick(graph=without_normalizer, contract=unobserved)
    found = text_of(case, "normalizer", Verdict.WARN)
    assert "the file does not tell whether training had one: ask" in found
    assert "with the contract's scales it gets goal_torque wrist_2 0.0" in found
    assert run_check(case, "training").verdict is Verdict.WARN
    assert "reached 0 of 8 goals" in text_of(case, "simulation", Verdict.FAIL)


@pytest.mark.usefixtures("two_goals")
def test_scale_in_degrees_gives_unscaled_observations(sick):
    def degrees(data):
        term = data["observation"][0]
        term["scale"] = [scale / 57.3 for scale in term["scale"]]

    case = sick(contract=degrees)
    found = text_of(case, "normalizer", Verdict.WARN)
    assert re.search(r"the network gets joint_position shoulder_lift 9\d\.", found)
    training = run_check(case, "training")
    assert training.verdict is Verdict.FAIL
    assert re.search(r"off training's, in deviations: joint_position wrist_2 \d\d\.", training.text)


@pytest.mark.usefixtures("one_goal")
def test_term_with_too_large_a_scale_has_no_effect(sick):
    def deafen(data):
        data["observation"][3]["scale"] = [850.0] * 3

    case = sick(contract=deafen)
    assert "actions hardly change with goal_from_tool (" in text_of(case, "normalizer", Verdict.WARN)
    training = run_check(case, "training")
    assert training.verdict is Verdict.WARN
    assert "readings hardly vary relative to training: goal_from_tool 0 " in training.text


# ---- order and sign that the names do not show ----


@pytest.mark.usefixtures("two_goals")
def test_wrong_joint_order_misses_every_goal(sick, shipped_policy):
    terms = json.loads(metadata(onnx.load(shipped_policy), CONTRACT_KEY).value)["observation"]
    case = sick(graph=in_another_order([2, 0, 1, 3, 5, 4], terms), contract=unobserved)
    assert run_check(case, "simulation").verdict is Verdict.FAIL
    training = run_check(case, "training")
    assert training.verdict is Verdict.FAIL
    assert "joint_position shoulder_lift 7." in training.text
    assert "and order with training" in training.text


@pytest.mark.usefixtures("one_goal")
def test_reversed_actions_miss_every_goal(sick):
    case = sick(graph=answering(helper.make_node("Neg", ["said"], ["action"])))
    trial = text_of(case, "simulation", Verdict.FAIL)
    assert "joint signs and order in the network" in trial
    assert "links would come closer than the collision margin" in trial
    assert "of all actions are at their clip" in run_check(case, "normalizer").text
    for check, said in (
        ("delay", "cannot be seen"),
        ("jitter", "cannot be seen"),
        ("chatter", "means little"),
    ):
        after = run_check(case, check)
        assert (after.verdict, said in after.text) == (Verdict.WARN, True)


# ---- activation ----


def test_a_default_pose_that_is_not_home_jumps_at_activation(sick, brief):
    def elsewhere(data):
        offset = [0.0, -1.0, 1.0, -1.5, -1.5, 0.0]
        data["action"].update(mode="position", offset=offset, leash_rad=None, scale=[0.05] * 6)

    found = text_of(sick(contract=elsewhere), "first target", Verdict.FAIL)
    assert "at the first step it sends shoulder_lift 0.6" in found
    assert "the home pose of robot.toml is not the default pose of training" in found


@pytest.mark.usefixtures("one_goal")
def test_doubled_scale_starts_too_fast(double):
    found = text_of(double, "first target", Verdict.WARN)
    assert "without the smoother the first step would need shoulder_pan 5.0" in found


# ---- delay, jitter, shaking ----


@pytest.mark.usefixtures("two_goals")
def test_noisy_policy_shakes(nervous):
    found = text_of(nervous, "chatter", Verdict.WARN)
    assert re.match(r"it chatters: shoulder_pan [678][.\d]*, ", found)


@pytest.mark.parametrize(
    ("least", "verdict", "said"),
    [
        (simulated_run.HALF_PERIOD_LATE, Verdict.WARN, "with actions 20 ms late"),
        (simulated_run.PERIOD_LATE, Verdict.FAIL, "with actions only 10 ms late"),
    ],
    ids=["a period", "half a period"],
)
@pytest.mark.usefixtures("one_goal")
def test_delay_absent_in_training_is_named(sick, monkeypatch, least, verdict, said):
    """Larger actions bear half a period and no whole one; the second time a whole one stands for the half."""
    monkeypatch.setattr(task_checks, "HALF_PERIOD_LATE", least)
    case = sick(contract=lambda data: data["action"].update(scale=[0.08] * 6))
    found = text_of(case, "delay", verdict)
    assert re.match(rf"{said} it reaches \d+ goals instead of \d+", found)
    assert "measure the robot's delay from sensor to motion, and train with it" in found


@pytest.mark.usefixtures("two_goals")
def test_policy_sensitive_to_jitter_is_named(nervous):
    """It reaches half as many goals: 6 of 12."""
    found = text_of(nervous, "jitter", Verdict.WARN)
    assert re.search(r"random delays of actions up to 20 ms it reaches \d+ goals instead", found)
    assert "run it on a computer with reliable timing" in found


@pytest.mark.usefixtures("one_goal")
def test_stops_by_late_packets_are_named(sick, tmp_path):
    robot, digest = robot_and_digest(tmp_path, toml=[("delay_s = 0.008", "delay_s = 0.025")])
    found = text_of(sick(robot, contract=digest), "simulation", Verdict.WARN)
    assert re.search(r"stopped \d+ times: sensor samples are missing \(\d+\)", found)


# ---- heat ----


def test_overheating_motors_are_named_with_the_hour(sick, tmp_path):
    cool = ("housing_resistance_k_per_w = 4.0", "housing_resistance_k_per_w = 15.0")
    robot, digest = robot_and_digest(tmp_path, toml=[cool])
    found = text_of(sick(robot, contract=digest), "heat", Verdict.FAIL)
    assert (
        "after eight hours of this work, with middle values of draws.toml, at 25 °C: shoulder_lift 12"
        in found
    )
    assert re.search(r"too hot: the first is too hot within [678][.\d]* h", found)


def test_eight_hours_equal_the_two_node_model():
    current, friction_power = np.array([1.0, 3.0, 2.0, 0.3, 0.2, 0.1]), np.zeros(6)
    found = winding_temperature(
        SPEC, HeatLoad(current=current, friction_power=friction_power, ambient=25.0), 3600.0
    )
    lift = MotorHeat(
        resistance=0.5,
        alpha=0.0039,
        reference_c=25.0,
        winding_to_housing=1.0,
        housing_to_ambient=4.0,
        winding_capacity=40.0,
        housing_capacity=1200.0,
    )
    assert found[1] == pytest.approx(temperatures(lift, 3.0, 25.0, 3600.0)[0])
    warmer = winding_temperature(
        SPEC, HeatLoad(current=current, friction_power=friction_power + 2.0, ambient=25.0), 1e6
    )
    np.testing.assert_allclose(
        (
            warmer
            - winding_temperature(
                SPEC, HeatLoad(current=current, friction_power=friction_power, ambient=25.0), 1e6
            )
        )[3:],
        14.0,  # 2 W times 7 K/W
        rtol=1e-2,
    )


def test_friction_and_iron_are_a_few_watts(sound):
    friction_power = sound.run.heat_load.friction_power
    assert ((friction_power > 0.01) & (friction_power < 10.0)).all()
    assert friction_power[:3].sum() > friction_power[3:].sum()


# ---- robots that walk ----


@pytest.mark.parametrize(("trained_on", "robot"), [("walker", "arm6"), ("arm", QUADRUPED.folder)])
def test_policy_of_another_robot_gets_all_rows(tmp_path, trained_on, robot):
    arm = arm_contract()
    soft = arm.action.model_copy(update={"kp": (100.0,) * SPEC.n, "kd": (10.0,) * SPEC.n})
    contract = walking_contract() if trained_on == "walker" else arm.model_copy(update={"action": soft})
    w = np.zeros((contract.observation_size, contract.action_size), np.float32)
    node = helper.make_node("MatMul", ["observation", "w"], ["action"])
    case = CheckContext(written(tmp_path, [node], {"w": w}, contract), robot)
    found = {each.check: each for each in run_checks(case)}
    assert list(found) == list(CHECKS)
    assert found["loader"].verdict is Verdict.FAIL
    assert f"found gains of {len(contract.joint_names)} joints, expected {case.spec.n}" in found["gains"].text


def test_walking_robot_is_checked(tmp_path, brief):
    """A policy that only stands: it hears nothing, asks for nothing, and falls or not by its springs alone."""
    contract = walking_contract()
    w = np.zeros((contract.observation_size, contract.action_size), np.float32)
    node = helper.make_node("MatMul", ["observation", "w"], ["action"])
    case = CheckContext(written(tmp_path, [node], {"w": w}, contract), QUADRUPED.folder)
    assert run_check(case, "loader").verdict is Verdict.PASS
    doubts = text_of(case, "sources", Verdict.WARN)
    assert "base_linear_velocity (base_linear_velocity): no sensor measures it" in doubts
    assert "base_orientation (base_orientation): no sensor measures yaw" in doubts
    assert "it does not respond to tilt" in run_check(case, "tilt").text
    first = run_check(case, "first target")
    assert first.verdict is Verdict.PASS
    assert first.text.startswith("the first step asks for ")
    assert "does not tell whether training had one" in run_check(case, "normalizer").text


@pytest.mark.parametrize(("command_s", "seconds"), [(2.0, 4.2), (30.0, 5.2)])
def test_walking_robot_without_a_finished_command_does_not_count_as_working(
    tmp_path, simulate_for, monkeypatch, command_s, seconds
):
    """Trained with gravity of the other sign it asks for nothing upright; as it is here, it folds up."""
    simulate_for(seconds)
    monkeypatch.setattr(simulated_run, "COMMAND_S", 3.0)
    folder = shutil.copytree(QUADRUPED.folder, tmp_path / "robot")
    text = (folder / "robot.toml").read_text()
    (folder / "robot.toml").write_text(text.replace("command_s = 2.0", f"command_s = {command_s}"))
    contract = walking_contract(load_robot(folder))
    w = np.zeros((contract.observation_size, contract.action_size), np.float32)
    w[PLACES["projected_gravity"]] = [[0.3, -0.3] * 6, [0.3, 0.3, -0.3, -0.3] * 3, [1.0] * 12]
    node = helper.make_node("Gemm", ["observation", "w", "b"], ["action"])
    case = CheckContext(written(tmp_path, [node], {"w": w, "b": -np.ones(12, np.float32)}, contract), folder)
    assert not case.works
    assert "upright its actions are smaller with gravity with the other sign" in run_check(case, "tilt").text


# ---- what cannot be lived ----


def test_robot_that_cannot_be_simulated_has_one_row_with_the_reason(sick, tmp_path):
    robot, digest = robot_and_digest(tmp_path, xml=[('actuatorfrcrange="-150 150" ', "")])
    case = sick(robot, contract=digest)
    trial = text_of(case, "simulation", Verdict.FAIL)
    assert "not tried: " in trial
    assert "no actuatorfrcrange on joints shoulder_pan, shoulder_lift, elbow" in trial
    for check in ("training", "first target", "chatter", "delay", "jitter", "heat"):
        assert (run_check(case, check).verdict, run_check(case, check).text) == (
            Verdict.WARN,
            "not tried: see row simulation.",
        )


def test_policy_output_of_nan_never_starts(sick, brief):
    nan = answering(
        helper.make_node("Sub", ["said", "said"], ["none"]),
        helper.make_node("Div", ["none", "none"], ["action"]),
    )
    case = sick(graph=lambda model: None)
    broken = onnx.load(case.path)
    nan(broken)
    case.path.write_bytes(broken.SerializeToString())
    found = text_of(CheckContext(case.path), "simulation", Verdict.FAIL)
    assert "a robot did not start: a number is not finite" in found


def test_overflowing_scale_is_not_simulated(sick, brief):
    def tiny(data):
        data["observation"][0]["scale"] = [1e-300] * 6

    case = sick(contract=tiny)
    found = text_of(case, "simulation", Verdict.FAIL)
    assert found.startswith("not tried: a")
    assert run_check(case, "training").text == "not tried: see row simulation."


# ---- the command ----


@pytest.fixture
def command(call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    return partial(call, checking.cli)


@pytest.mark.usefixtures("one_goal")
def test_command_prints_every_row_and_exits_with_1_on_a_failure(command, arm_policy, monkeypatch):
    monkeypatch.setattr(joint_order, "VARIANTS_MAX", 1)
    code, said, _ = command(arm_policy)
    assert code == 1
    assert all(f" {check} " in said for check in CHECKS)
    assert "8 robots reached 0 of 8 goals" in said
    assert "6 joints have too many orders to try" in said


def test_command_exits_with_0_on_warnings_only(command, shipped_policy, monkeypatch, sound):
    monkeypatch.setattr(checking, "CheckContext", lambda path, robot: sound)
    code, said, _ = command(shipped_policy, "--robot", "arm6")
    assert code == 0
    assert said.count(" pass ") == len(CHECKS) - 3
    assert said.count(" warn ") == 3  # a goal camera is exteroceptive


def test_network_with_a_fixed_batch_is_bad_input(command, shipped_policy, tmp_path):
    def one_only(model):
        shape = helper.make_node("Reshape", ["said", "shape"], ["action"])
        answering(shape, shape=np.array([1, 6]))(model)

    model = onnx.load(shipped_policy)
    one_only(model)
    (tmp_path / "one.onnx").write_bytes(model.SerializeToString())
    code, said, complaint = command(tmp_path / "one.onnx")
    assert (code, said) == (2, "")
    assert f"error: {tmp_path / 'one.onnx'}: cannot be run at batch 64: " in complaint


def test_bad_input_exits_with_2_and_one_line(command, tmp_path, arm_policy):
    (tmp_path / "evil.onnx").write_bytes(b"nothing good")
    for arguments, why in (
        ((tmp_path / "evil.onnx",), "not a"),
        ((tmp_path / "none.onnx",), "cannot be read"),
        ((arm_policy, "--robot", "hexapod"), "--robot hexapod: no such folder"),
    ):
        code, said, complaint = command(*arguments)
        assert (code, said) == (2, "")
        assert complaint.startswith("error: ")
        assert why in complaint
        assert complaint.count("\n") == 1


def test_the_doctor_needs_no_torch():
    code = "import sys, policies.doctor.cli; sys.exit('torch' in sys.modules)"
    root = ROOT
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0
