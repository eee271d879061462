"""The whole tick on planar4 with a wheel: a joint without ends, which follows speeds, with stiffness or without."""

import numpy as np
import pytest

from deploy.motion.takeover import TAKEOVER_S
from deploy.reasons import Reason
from deploy.state import Mode
from robots.motors.drive_gains import drive_gains
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.planar import arm_with_wheel, planar_contract, wheel_contract
from support.runtimes import Thinking, every

simulate = pytest.importorskip("deploy.simulation").simulate
ARM_S = pytest.importorskip("eval.shard.job").ARM_S
make_judge = pytest.importorskip("eval.shard.judging").make_judge
judge_tick = pytest.importorskip("eval.shard.judging").judge_tick

TURN = 2 * np.pi
ROBOTS = 3
CONTRACTS = {"stiff": lambda spec: planar_contract(spec, "velocity"), "without stiffness": wheel_contract}


class Told(Thinking):
    """A policy that says what it is told to."""

    def __init__(self, action):
        self.action = np.array(action)

    def step(self, observation):
        return np.tile(self.action, (len(observation), 1))


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return load_robot(arm_with_wheel(tmp_path_factory.mktemp("wheel")))


def rolling(spec, contract, action):
    """A runtime that is armed, and its policy."""
    seeds, policy = [robot_seed(5, robot) for robot in range(ROBOTS)], Told(action)
    runtime = simulate(spec, contract, seeds, policy, threads=1)[0]
    for _ in range(round(ARM_S / spec.dt)):
        runtime.tick()
    assert not runtime.arm(every(runtime)).any()
    return runtime, policy


def live(runtime, seconds, judge=None):
    """Commands of the wheel (T, B) stiffness and its true speed."""
    stiffness, speeds = [], []
    for _ in range(round(seconds / runtime.spec.dt)):
        observation = runtime.sense()
        action = None if observation is None else runtime.policy.step(observation)
        runtime.act(action)
        truth = runtime.robot.truth()
        if judge is not None:
            judge_tick(judge, truth, runtime, action)
        stiffness.append(runtime.command.drive.kp.copy())
        speeds.append(truth.qd[:, -1].copy())
    return np.array(stiffness), np.array(speeds)


def bad_ticks(judge):
    counts = judge.counts()
    return {monitor.name: counts.total(monitor.name) for monitor in counts.monitors if monitor.hard}


@pytest.mark.parametrize("contract", CONTRACTS.values(), ids=CONTRACTS)
def test_a_wheel_turns_on_and_on(spec, contract):
    runtime, _ = rolling(spec, contract(spec), [0.0, 0.0, 0.0, 0.7])
    judge = make_judge(spec, runtime.contract, ROBOTS)
    _, speeds = live(runtime, 8.0, judge)
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    angle = runtime.robot.truth().q[:, -1]
    assert (angle > 2 * TURN).all()  # beyond the range of the encoder's data sheet
    np.testing.assert_allclose(runtime.state.q[:, -1], angle, atol=0.02)
    np.testing.assert_allclose(speeds[-1], 0.7 * 3.14, atol=0.05)
    assert (runtime.state.nis < 3.0).all()
    assert not any(bad_ticks(judge).values())


@pytest.mark.parametrize("contract", CONTRACTS.values(), ids=CONTRACTS)
def test_a_wheel_keeps_the_limits_of_motion(spec, contract):
    runtime, policy = rolling(spec, contract(spec), [0.0] * 4)
    judge, rng = make_judge(spec, runtime.contract, ROBOTS), np.random.default_rng(0)
    for _ in range(40):
        policy.action = rng.uniform(-1.0, 1.0, 4)
        live(runtime, 0.1, judge)
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    assert not any(bad_ticks(judge).values())
    counts = judge.counts()
    for limit in ("acceleration", "jerk"):  # of the speeds sent to the wheel, too
        assert counts.worst[:, counts.columns(limit)][:, -1].min() > 0.9


def test_a_wheel_without_stiffness_is_stopped_by_a_drive_that_stiffens(spec):
    runtime, _ = rolling(spec, wheel_contract(spec), [0.0, 0.0, 0.0, 1.0])
    judge = make_judge(spec, runtime.contract, ROBOTS)
    before, speeds = live(runtime, 3.0, judge)
    own, fast = drive_gains(spec).kp, speeds[-1].min()
    np.testing.assert_array_equal(before[-1], np.tile([*own[:-1], 0.0], (ROBOTS, 1)))
    runtime.stop(Reason.OPERATOR)
    stiffness, speeds = live(runtime, 1.0, judge)
    assert (stiffness[:, :, :-1] == own[:-1]).all()  # the arm's drives stay stiff
    takeover = stiffness[: round(TAKEOVER_S / spec.dt), 0, -1]
    assert takeover[0] == pytest.approx(0.01 * own[-1])
    assert (np.diff(takeover) > 0).all()
    assert (stiffness[len(takeover) + 1 :, :, -1] == own[-1]).all()
    assert fast > 0.7 * 3.14
    assert (np.diff(speeds, axis=0) < 0.05).all()  # it only slows down
    assert (np.abs(speeds[-1]) < 0.01).all()
    assert (runtime.supervisor.mode == Mode.LATCHED).all()
    assert not any(bad_ticks(judge).values())


def test_a_wheel_that_is_slower_than_told_is_no_tracking_error(spec):
    """Without stiffness no torque grows with the angle that it is behind; the estimate shows how fast it is."""
    weak = wheel_contract(spec)
    damping = (*weak.action.kd[:-1], 0.1)  # little more than its friction at full speed
    weak = weak.model_copy(update={"action": weak.action.model_copy(update={"kd": damping})})
    runtime, _ = rolling(spec, weak, [0.0, 0.0, 0.0, 0.8])
    _, speeds = live(runtime, 3.0)
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    assert (runtime.setpoint.qd[:, -1] > 2.0).all()
    assert (speeds[-1] < 1.9).all()
    np.testing.assert_allclose(runtime.state.qd[:, -1], speeds[-1], atol=0.2)
    np.testing.assert_allclose(runtime.setpoint.q[:, -1], runtime.robot.truth().q[:, -1], atol=0.05)
    assert (runtime.state.nis < 3.0).all()


def test_restored_goes_on_bit_for_bit(spec):
    runtime, _ = rolling(spec, wheel_contract(spec), [0.2, 0.0, -0.2, 0.9])
    live(runtime, 1.0)
    state, body = runtime.save(), runtime.robot.save()
    live(runtime, 0.5)
    expected = runtime.save()
    runtime.restore(state)
    runtime.robot.restore(body)
    live(runtime, 0.5)
    for name, array in runtime.save().items():
        np.testing.assert_array_equal(array, expected[name], err_msg=name)


def test_a_stop_right_after_a_restore_is_the_one_that_was_prepared(spec):
    runtime, _ = rolling(spec, wheel_contract(spec), [0.2, 0.0, -0.2, 0.9])
    live(runtime, 1.0)
    runtime.restore(runtime.save())
    runtime.stop(Reason.OPERATOR)
    stiffness, _ = live(runtime, runtime.spec.dt)
    assert stiffness[0, :, -1] == pytest.approx(0.01 * drive_gains(spec).kp[-1])
