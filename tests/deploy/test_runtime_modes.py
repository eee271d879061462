"""The whole tick in velocity and in torque mode, on drawn arms."""

import numpy as np
import pytest

from deploy.policy.compatibility import check_contract
from deploy.reasons import Reason
from deploy.state import Mode
from robots.errors import ContractError
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from support.arm6 import SPEC, copy_of_arm
from support.modes import SCALES, mode_contract
from support.runtimes import DT, N, assert_same, built, every, heard

make_judge = pytest.importorskip("eval.shard.judging").make_judge
judge_tick = pytest.importorskip("eval.shard.judging").judge_tick
load_robot = pytest.importorskip("robots.spec").load_robot
OPERATOR = Reason.OPERATOR
hostile = pytest.importorskip("eval.faults.hostile_policy")
takeover = pytest.importorskip("deploy.motion.takeover")
TAKEOVER_S, RANGE_SHARE = takeover.TAKEOVER_S, takeover.RANGE_SHARE


def live(runtime, policy, ticks, judge=None):
    """Modes (T, B) of the supervisor while a policy is called with the runtime."""
    modes = []
    for _ in range(ticks):
        observation = runtime.sense()
        action = None if observation is None else policy(runtime)
        runtime.act(action)
        modes.append(runtime.supervisor.mode.copy())
        if judge is not None:
            judge_tick(judge, runtime.robot.truth(), runtime, action)
    return np.array(modes)


def armed(mode, robots, policy, **changes):
    runtime = built(robots, contract=mode_contract(mode, **changes))
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    live(runtime, policy, 24)
    return runtime


def rest(runtime):
    return np.zeros((runtime.robot.robots, N))


def weight(runtime):
    """Action that carries the nominal arm."""
    fleet, still = Fleet(SPEC, runtime.robot.robots), np.zeros(runtime.state.q.shape)
    return fleet.torque(runtime.state.q, still, still) / SCALES["torque"]


def test_a_target_speed_becomes_the_speed_of_the_links():
    runtime = armed("velocity", 3, rest)
    live(runtime, lambda r: np.tile([0.1, 0, 0, 0, 0, -0.2], (3, 1)), 80)
    expected = np.array([0.1, 0, 0, 0, 0, -0.2]) * SCALES["velocity"]
    truth = runtime.robot.truth().qd
    np.testing.assert_allclose(truth, np.tile(expected, (3, 1)), atol=0.05)
    np.testing.assert_allclose(runtime.setpoint.qd, np.tile(expected, (3, 1)), atol=1e-9)
    assert (runtime.command.drive.mode == ControlMode.VELOCITY).all()
    np.testing.assert_array_equal(runtime.command.drive.kp, np.tile(drive_gains(SPEC).kp, (3, 1)))


CHANGES = {"position": 0.01, "velocity": 0.1, "torque": 0.5}
"""rad, rad/s and N·m of each policy step."""


@pytest.mark.parametrize("mode", CHANGES)
def test_change_of_a_target_is_capped_in_each_policy_step(mode):
    change = CHANGES[mode]
    runtime, sent = armed(mode, 2, rest, change_max=(change,) * N), []
    for _ in range(36):
        live(runtime, lambda r: np.ones((2, N)), 1)
        assert not runtime.supervisor.stopping.any()
        sent.append(runtime.target.value.copy())
    steps = np.diff(np.array(sent), axis=0)
    assert steps.max() == pytest.approx(change)
    assert (steps >= -1e-12).all()


def test_an_arm_that_carries_its_weight_stays_where_it_is():
    """In torque mode no drive holds it: the nominal weight and friction do, for a while."""
    runtime = armed("torque", 4, weight)
    before = runtime.robot.truth().q.copy()
    modes = live(runtime, weight, 100)
    assert (modes == Mode.RUNNING).all()
    assert not runtime.command.drive.kp.any()
    assert np.abs(runtime.robot.truth().q - before).max() < 0.1
    np.testing.assert_allclose(runtime.command.tau, weight(runtime) * SCALES["torque"], atol=3.0)


def test_setpoint_in_torque_mode_is_where_joints_will_be():
    runtime, errors = armed("torque", 8, weight), []
    push = np.array([0.1, 0.1, -0.1, 0.3, -0.3, 0.3])
    for _ in range(120):
        live(runtime, lambda r: weight(r) + push * np.sin(6.0 * r.t), 1)
        running = runtime.supervisor.running
        errors.append(np.abs(runtime.setpoint.q - runtime.robot.truth().q)[running])
    errors = np.concatenate(errors)
    assert len(errors) > 400
    assert np.quantile(errors, 0.99) < 0.006  # rad: noise of the encoder, bias, play
    assert (runtime.state.nis < 3.0).all()


def test_a_stop_takes_over_with_position_drives_that_stiffen():
    policy = lambda r: weight(r) + np.array([0.3, 0, 0, 0, 0, 0.5])  # noqa: E731
    runtime = armed("torque", 2, weight)
    live(runtime, policy, 36)
    moving = np.abs(runtime.robot.truth().qd[:, 0])
    assert (moving > 0.2).all()
    runtime.stop(OPERATOR)
    stiffness, speeds = [], []
    for _ in range(120):
        live(runtime, policy, 1)
        stiffness.append(runtime.command.drive.kp[0, 0])
        speeds.append(np.abs(runtime.robot.truth().qd[:, 0]))
    own = drive_gains(SPEC).kp[0]
    assert stiffness[0] == pytest.approx(0.01 * own)
    assert (np.diff(stiffness[: round(TAKEOVER_S / DT)]) > 0).all()
    assert stiffness[round(TAKEOVER_S / DT)] == pytest.approx(own)
    assert (np.array(speeds) < moving + 0.15).all()
    assert (runtime.supervisor.mode == Mode.LATCHED).all()
    assert (speeds[-1] < 0.01).all()


def test_power_is_not_cut_before_drives_have_taken_over():
    runtime = armed("torque", 2, weight)
    live(runtime, weight, 20)
    runtime.stop(OPERATOR)
    for _ in range(round(TAKEOVER_S / DT)):
        live(runtime, weight, 1)
        assert runtime.command.powered.all()
    live(runtime, weight, 40)
    assert (runtime.supervisor.mode == Mode.LATCHED).all()
    assert not runtime.command.powered.any()


def test_drives_saturate_before_the_end_of_their_range_in_torque_mode():
    """No plan bounds what drives that take over make of an estimate that is behind."""
    runtime = armed("torque", 2, weight)
    for _ in range(2):
        live(runtime, weight, 5)
        assert (runtime.command.current_share <= 0.95).all()
        runtime.stop(OPERATOR)


def test_a_stop_does_not_pull_an_arm_back_with_all_of_its_torque():
    """Within some ticks, as one estimate may be wrong."""
    runtime = armed("torque", 2, weight)
    runtime.stop(OPERATOR)
    live(runtime, weight, round(TAKEOVER_S / DT / 2))
    smoother, state = runtime.smoother, runtime.state
    sent = smoother.ramp.tau.copy()
    down = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    planned = smoother.plan(rest(runtime), every(runtime), state._replace(q=smoother.q + down))
    for _ in range(2):
        smoother.takeover.commit(planned.drive)
        planned = smoother.plan(rest(runtime), every(runtime), state._replace(q=smoother.q + down))
    error, slower = planned.q - smoother.q - down, planned.qd - state.qd
    tau = sent + planned.drive.kp * error + planned.drive.kd * slower
    np.testing.assert_allclose(tau[:, 1], -RANGE_SHARE * torque_max(SPEC)[1])
    others = np.arange(N) != 1
    np.testing.assert_allclose(planned.drive.kp[:, others], smoother.takeover.drive.kp[:, others], rtol=1e-12)


@pytest.mark.parametrize("mode", ["velocity", "torque"])
def test_restored_goes_on_bit_for_bit(mode):
    one, other = armed(mode, 2, rest), built(2, contract=mode_contract(mode))
    policies = [hostile.push_joints(2.0, 0)] * 2
    live(one, hostile.random_actions(0), 50)
    one_robot = one.robot.save()
    other.restore(one.save())
    other.robot.restore(one_robot)
    for _ in range(120):
        for runtime, policy in zip((one, other), policies, strict=True):
            live(runtime, policy, 1)
    assert_same(one, other)


@pytest.mark.parametrize("mode", ["velocity", "torque"])
def test_a_stop_right_after_a_restore_is_the_one_that_was_prepared(mode):
    one, other = armed(mode, 2, rest), built(2, contract=mode_contract(mode))
    live(one, hostile.random_actions(0), 50)
    other.restore(one.save())
    other.robot.restore(one.robot.save())
    for runtime in (one, other):
        runtime.stop(OPERATOR)
        live(runtime, rest, 1)
    for found, expected in zip(other.command.drive, one.command.drive, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert_same(one, other)


def test_a_reset_ends_the_takeover_of_a_stop():
    runtime = armed("torque", 2, rest)
    runtime.stop(OPERATOR)
    live(runtime, rest, 3)
    assert (runtime.command.drive.kp < drive_gains(SPEC).kp).all()
    runtime.robot.reset(every(runtime), np.tile(SPEC.joint_array("q_home"), (2, 1)))
    runtime.reset(every(runtime))
    live(runtime, rest, 14)  # fewer ticks than a takeover takes
    assert not runtime.arm(every(runtime)).any()
    live(runtime, rest, 1)
    np.testing.assert_array_equal(runtime.command.drive.kd, np.tile(drive_gains(SPEC).kd, (2, 1)))


@pytest.mark.parametrize("mode", ["position", "velocity", "torque"])
def test_target_setpoint_and_command_carry_mode_and_gains(mode):
    runtime = armed(mode, 2, lambda r: np.zeros((2, N)))
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    gains = (0 * g if mode == "torque" else g for g in drive_gains(SPEC))
    expected = (np.full(2, ControlMode[mode.upper()]), *(np.tile(gain, (2, 1)) for gain in gains))
    for record in (runtime.target, runtime.setpoint, runtime.command):
        for found, wanted in zip(record.drive, expected, strict=True):
            np.testing.assert_array_equal(found, wanted)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make_policy",
    [lambda: hostile.random_actions(0), lambda: hostile.push_joints(2.0, 0), lambda: hostile.shake],
    ids=["random", "push", "shake"],
)
@pytest.mark.parametrize("mode", ["velocity", "torque"])
def test_no_adversary_causes_a_hard_event(mode, make_policy):
    robots = 8
    runtime = built(robots, contract=mode_contract(mode))
    judge, policy = make_judge(SPEC, runtime.contract, robots), make_policy()
    live(runtime, policy, 40, judge)
    assert not runtime.arm(every(runtime)).any()
    modes = live(runtime, policy, 1200, judge)
    counts = judge.counts()
    assert {e.monitor.name for e in counts.log() if e.monitor.hard} == set()
    assert (modes == Mode.RUNNING).mean() > 0.1
    assert counts.stops.sum() > robots


def test_a_mode_that_the_drives_lack_is_refused(tmp_path):
    folder = copy_of_arm(
        tmp_path, toml=[(r'modes = \["position", "velocity", "torque"\]', 'modes = ["position"]')]
    )
    spec = load_robot(folder)
    assert spec.control_modes == (ControlMode.POSITION,)
    contract = mode_contract("torque").model_copy(update={"robot_digest": spec.digest})
    with pytest.raises(
        ContractError, match=r"action\.mode: found 'torque'; the drives of arm6 have the modes position"
    ):
        check_contract(contract, spec, "x.onnx")
