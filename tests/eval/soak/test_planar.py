"""Planar robots through the commands: a policy that works, two that do not, and what is left of them."""

import json

import numpy as np
import pytest

pytest.importorskip("mujoco")

from deploy.operation.cli import cli as deploy_run
from deploy.policy.compatibility import check_contract
from deploy.policy.gain_bounds import damping_bounds, stiffness_bounds
from deploy.policy.policy import Policy
from deploy.reasons import Reason
from deploy.simulation import simulate
from deploy.state import Mode
from deploy.tasks.planar_reach import PlanarReach
from eval.shard.job import ARM_S
from eval.shard.judging import judge_tick, make_judge
from eval.soak.cli import cli as soak_test
from robots.models.planar_chain import PlanarChain
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from support.planar import PLANAR3, PLANAR4, REACH_M, hostile, joint_angles, reaching, trembling

ROBOTS = pytest.mark.parametrize("spec", [PLANAR3, PLANAR4], ids=lambda spec: spec.name)


@ROBOTS
def test_the_reaching_policy_solves_the_inverse_kinematics(tmp_path, spec):
    """Its actions are the angles at which the chain's tool is at the goal."""
    task = PlanarReach(spec, [robot_seed(0, robot) for robot in range(64)])
    policy = Policy.load(reaching(tmp_path / "policy.onnx", spec), spec)
    policy.resize(64)
    observation = np.zeros((64, policy.contract.observation_size), dtype=np.float32)
    observation[:, -3:] = task.goal / REACH_M
    q = np.pi / 2 * policy.step(observation).astype(float)
    np.testing.assert_allclose(q[:, :3], joint_angles(task.goal), atol=1e-5)
    np.testing.assert_allclose(PlanarChain.of_robot(spec).tool(q), task.goal, atol=1e-5)


@ROBOTS
def test_a_planar_robot_runs_under_its_policy(call, tmp_path, spec):
    options = ("--robot", spec.name, "--policy", reaching(tmp_path / "policy.onnx", spec))
    code, _, _ = call(
        deploy_run, *options, "--backend", "sim", "--duration", 5, "--speed", "max", "--out", tmp_path / "run"
    )
    goals = json.loads((tmp_path / "run" / "summary.json").read_text())["goals"]
    assert (code, goals) == (0, {"reached": 1, "attempted": 1})


def soaked(call, folder, policy, spec, seconds):
    code, said, _ = call(
        soak_test,
        *("--robot", spec.name, "--policy", policy, "--hours", seconds / 3600, "--robots", 16),
        *("--workers", 1, "--out", folder),
    )
    return code, said, json.loads((folder / "report.json").read_text())


@pytest.mark.slow
def test_a_soak_reports_all_goals_and_core_goals(call, tmp_path):
    policy = reaching(tmp_path / "policy.onnx")
    _, said, report = soaked(call, tmp_path / "soak", policy, PLANAR3, 24.0)
    goals, core = report["goals"], report["goals"]["core"]
    assert goals["due"] == 16 * 24 / PlanarReach.config.period_s
    assert 0.6 * goals["due"] < core["attempted"] < goals["due"]
    assert core["success"] == core["reached"] / core["attempted"] >= 0.95
    assert goals["success"] > 0.9
    assert f"Goals inside 90 % of the joint ranges reached: {100 * core['success']:.2f} %." in said.replace(
        "\n", " "
    )
    assert report["evidence"]["hard_events"] == 0


def count_events(policy, contract):
    """Return the counts of ten seconds of sixteen drawn robots, judged by ground truth, and their runtime."""
    seeds = [robot_seed(2, robot) for robot in range(16)]
    runtime, robot = simulate(PLANAR3, contract, seeds, policy)
    judge = make_judge(PLANAR3, contract, 16)
    for tick in range(2000):
        if tick == round(ARM_S / PLANAR3.dt):
            assert not runtime.arm(np.ones(16, dtype=bool)).any()
        runtime.tick()
        judge_tick(judge, robot.truth(), runtime, None)
    counts = judge.counts()
    assert (counts.worst[:, counts.columns("velocity")].max(axis=0) > 0.4).all()  # it did move
    return counts, runtime


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["position", "velocity", "torque"])
@pytest.mark.parametrize("attack", [hostile, trembling], ids=lambda attack: attack.__name__)
def test_hostile_policies_leave_no_hard_event(tmp_path, mode, attack):
    """Power goes only for stops that repeat."""
    policy = Policy.load(attack(tmp_path / "policy.onnx", PLANAR3, mode), PLANAR3)
    counts, runtime = count_events(policy, policy.contract)
    assert counts.hard_events().tolist() == [0] * 16
    latched = runtime.supervisor.mode == Mode.LATCHED
    assert (runtime.supervisor.reason[latched] == Reason.REPEATED | Reason.ACCELERATION).all()
    assert not latched.any() or mode == "torque"


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.001, 0.999])
@pytest.mark.parametrize("stiffness", [0.001, 0.999])
def test_hostile_policy_with_gains_just_inside_their_bounds_leaves_no_hard_event(
    tmp_path, stiffness, damping
):
    policy = Policy.load(hostile(tmp_path / "policy.onnx"), PLANAR3)
    kp = between(stiffness_bounds(PLANAR3, ControlMode.POSITION), stiffness)
    kd = between(damping_bounds(PLANAR3, ControlMode.POSITION, kp), damping)
    action = policy.contract.action.model_copy(update={"kp": tuple(kp.tolist()), "kd": tuple(kd.tolist())})
    contract = policy.contract.model_copy(update={"action": action})
    check_contract(contract, PLANAR3, "policy.onnx")
    counts, _ = count_events(policy, contract)
    assert counts.hard_events().tolist() == [0] * 16


def between(bounds, share):
    return bounds.low + share * (bounds.high - bounds.low)
