"""The shipped quadruped stands: nothing stops, falls or gets hot, and its base is estimated well."""

from types import SimpleNamespace

import numpy as np
import pytest

from deploy.reasons import Reason
from deploy.sources.floating_base import pitch_roll
from deploy.state import Mode
from robots.models.nominal_model import imu_in_base, load_pinocchio
from robots.randomness import robot_seed
from robots.rotations import matrix, matvec
from support.quadruped import EGOCENTRIC, HOME, QUADRUPED, quadruped_contract

simulate = pytest.importorskip("deploy.simulation").simulate
judging = pytest.importorskip("eval.shard.judging")

DT, ARM_S, SETTLED_S = QUADRUPED.dt, 0.4, 2.0
FOOT_M = 0.02
SOFT = ("position_soft", "heat_soft", "position_requested")
GAINS = {"kp": (40.0,) * 12, "kd": (1.0,) * 12}


def rms(errors):
    return np.sqrt((np.concatenate(errors) ** 2).mean(axis=0))


def stand(robots, seconds, gains):
    """Robots that are armed and stand: contract, runtime, judge's counts, errors of the estimate, last observation."""
    contract = quadruped_contract()
    if gains:
        contract = contract.model_copy(update={"action": contract.action.model_copy(update=gains)})
    runtime, robot = simulate(QUADRUPED, contract, [robot_seed(5, k) for k in range(robots)])
    judge, zero = judging.make_judge(QUADRUPED, contract, robots), np.zeros((robots, 12))
    imu = imu_in_base(QUADRUPED, load_pinocchio(QUADRUPED)[0])
    errors, observation = {"velocity": [], "pitch_roll": [], "height": [], "angular": []}, None
    for tick in range(round((ARM_S + seconds) / DT)):
        if tick == round(ARM_S / DT):
            assert not runtime.arm(np.ones(robots, dtype=bool)).any()
        new = runtime.sense()
        action = None if new is None else zero
        observation = observation if new is None else new.copy()
        runtime.act(action)
        judging.judge_tick(judge, robot.truth(), runtime, action)
        if tick < (ARM_S + SETTLED_S) / DT or new is None:
            continue
        truth, base = robot.truth().base, runtime.base
        R = matrix(truth.quat_wxyz)
        at_imu = matvec(R.swapaxes(1, 2), truth.velocity) + np.cross(truth.angular_velocity, imu)
        errors["velocity"].append(base.velocity_in_base - at_imu)
        errors["angular"].append(base.angular_velocity - truth.angular_velocity)
        upright = pitch_roll(-matvec(R.swapaxes(1, 2), truth.up))
        errors["pitch_roll"].append(pitch_roll(base.gravity) - upright)
        height = runtime.capabilities.by_name["floating_base"].height(runtime.sample, runtime.state)
        errors["height"].append(height[:, 0] - (truth.position[:, 2] + (R @ imu)[:, 2] - FOOT_M))
    return SimpleNamespace(
        runtime=runtime, robot=robot, counts=judge.counts(), errors=errors, observation=observation
    )


@pytest.fixture(scope="module")
def stood():
    return stand(2, 4.0, None)


def assert_nothing_happened(found):
    counts = found.counts
    assert (found.runtime.supervisor.mode == Mode.RUNNING).all()
    assert not counts.stops.any()
    events = {each.name: int(counts.total(each.name)) for each in counts.channels.catalogue}
    assert {name: n for name, n in events.items() if n and name not in SOFT} == {}
    assert counts.worst[:, counts.columns("tilt")].max() < 0.3


def test_it_stands(stood):
    assert_nothing_happened(stood)
    truth = stood.robot.truth()
    assert (truth.contact_n > 20.0).all()
    assert np.abs(truth.q - HOME).max() < 0.15
    assert (np.abs(truth.base.position[:, 2] - 0.268) < 0.01).all()
    np.testing.assert_array_equal(stood.runtime.command.current_share, QUADRUPED.margins.tau)


@pytest.mark.parametrize(("cool", "share"), [(1.0, QUADRUPED.margins.tau), (0.5, 0.5)])
@pytest.mark.parametrize("running", [True, False])
def test_its_drives_give_the_least_of_what_heat_and_margin_leave(stood, cool, share, running, monkeypatch):
    runtime = stood.runtime
    left = SimpleNamespace(current_share=np.full((2, 12), cool))
    monkeypatch.setattr(runtime.estimator.windings, "foldback", left)
    runtime._send(runtime.setpoint, runtime.verdict.tau, np.full(2, running))
    expected = share if running else QUADRUPED.margins.tau
    np.testing.assert_array_equal(runtime.command.current_share, expected)


def test_the_estimate_of_its_base_is_close(stood):
    assert (rms(stood.errors["velocity"]) < 0.02).all()
    assert (rms(stood.errors["angular"]) < 0.02).all()
    assert (rms(stood.errors["pitch_roll"]) < 0.008).all()
    assert rms(stood.errors["height"]) < 0.003


def test_it_observes_the_units_layout(stood):
    """Velocities, pitch and roll and their rates, legs, feet, height; nothing of its place and heading in the world."""
    contract = stood.runtime.contract
    assert contract.observation_size == EGOCENTRIC + 3 + 2
    row, start = stood.observation[0], 0
    found = {}
    for term in contract.observation:
        found[term.name] = row[start : start + term.size] * term.scale
        start += term.size
    assert (np.abs(row) <= 1.05).all()
    np.testing.assert_allclose(found["joint_position"], stood.robot.truth().q[0], atol=0.01)
    np.testing.assert_array_equal(found["foot_contact"], 1.0)
    assert found["base_height"] == pytest.approx(0.243, abs=0.01)
    np.testing.assert_allclose(found["base_pitch_roll"], 0.0, atol=0.03)
    np.testing.assert_allclose(found["velocity_command"], stood.runtime.task.goal[0], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("gains", [None, GAINS], ids=["own gains", "gains of training"])
def test_drawn_robots_stand_for_long(gains):
    """Pushed and loaded; without heat, stop or fall."""
    found = stand(8, 12.0, gains)
    assert_nothing_happened(found)
    assert (rms(found.errors["velocity"]) < 0.012).all()
    assert (rms(found.errors["pitch_roll"]) < 0.006).all()
    assert rms(found.errors["height"]) < 0.004
    truth = found.robot.truth()
    assert (truth.winding_c < QUADRUPED.motor_array("winding_soft_c") - 20).all()
    assert not Reason(int(np.bitwise_or.reduce(found.runtime.supervisor.reason)))


@pytest.mark.slow
def test_folded_legs_are_a_fall():
    """The model falls as a robot does: trunk on the floor, supervisor latched or stopped, a monitor reports."""
    contract = quadruped_contract()
    runtime, robot = simulate(QUADRUPED, contract, [robot_seed(5, 0)])
    judge = judging.make_judge(QUADRUPED, contract, 1)
    for tick in range(round(4.0 / DT)):
        if tick == round(ARM_S / DT):
            assert not runtime.arm(np.ones(1, dtype=bool)).any()
        action = None if runtime.sense() is None else np.zeros((1, 12))
        runtime.act(action)
        robot.plant.batch.bind("xfrc_applied")[0, 1, 3:] = 25.0 * (tick > 1.0 / DT), 0.0, 0.0  # rolls it over
        judging.judge_tick(judge, robot.truth(), runtime, action)
    counts = judge.counts()
    assert counts.total("tilt") == 1
    assert Reason(int(runtime.supervisor.reason[0])) & (Reason.FALLEN | Reason.DIVERGED)
    assert runtime.supervisor.mode.tolist() == [Mode.LATCHED]
