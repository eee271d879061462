import numpy as np
import pytest

from deploy.reasons import Reason
from deploy.state import Mode
from deploy.tasks.goal_pool import ReachConfig, goal_pool
from robots.distributions import load_distributions
from robots.draws import draw
from robots.models.fleet import Fleet
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.randomness import robot_seed
from support.arm6 import SPEC
from support.contracts import arm_contract
from support.runtimes import (
    N,
    Saying,
    Wandering,
    assert_same,
    assert_within_limits,
    bits,
    built,
    every,
    heard,
    play,
    running,
)

SimRobot = pytest.importorskip("deploy.backends.sim.robot").SimRobot
simulate = pytest.importorskip("deploy.simulation").simulate
ARM_S = pytest.importorskip("eval.shard.job").ARM_S

POOL = goal_pool(SPEC, ReachConfig())


def test_nothing_moves_before_it_is_armed():
    runtime = built()
    _, modes = play(runtime, 60)
    assert (modes == Mode.DISARMED).all()
    assert not runtime.command.powered.any()
    assert np.abs(runtime.robot.truth().q - SPEC.joint_array("q_home")).max() < 0.01


def test_starts_from_the_measured_pose_without_a_jump():
    runtime = built(4)
    pose = POOL.q[[3, 500, 5000, 9000]]
    runtime.robot.reset(every(runtime), pose)
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    before = runtime.setpoint.q.copy()
    runtime.tick()
    np.testing.assert_allclose(runtime.command.q, before, rtol=0, atol=1e-12)
    np.testing.assert_allclose(runtime.command.q, pose, atol=5e-3)
    np.testing.assert_array_equal(runtime.command.qd, 0.0)
    assert runtime.command.powered.all()
    q, modes = play(runtime, 19)
    np.testing.assert_allclose(q, np.broadcast_to(before, q.shape), rtol=0, atol=1e-12)
    q, modes = play(runtime, 40)
    assert (modes == Mode.RUNNING).any(axis=0).all()
    assert_within_limits(np.concatenate((np.repeat(before[None], 3, axis=0), q)))
    assert np.abs(runtime.robot.truth().q - q[-1]).max() < 0.03


def test_setpoints_begin_at_the_mean_of_what_was_estimated_at_rest():
    """Encoders twice as noisy as their data sheet says: one estimate is off by 0.8 mrad, the mean by 0.3."""
    seeds = [robot_seed(5, robot) for robot in range(16)]
    noisy = draw(load_distributions(SPEC), SPEC, seeds).replaced({"sensors.noise": 2.0, "sensors.bias": 0.0})
    runtime = simulate(SPEC, arm_contract(), seeds, Saying(16), draw=noisy)[0]
    heard(runtime)
    once, true = runtime.state.q.copy(), runtime.robot.truth().q.copy()
    assert not runtime.arm(every(runtime)).any()
    play = noisy["joints.backlash_rad"]
    off_at_first, off = (np.maximum(np.abs(q - true) - play, 0.0) for q in (once, runtime.setpoint.q))
    assert np.sqrt((off_at_first**2).mean()) > 0.7e-3
    assert np.sqrt((off**2).mean()) < 0.4e-3


def test_refuses_to_arm_with_reasons():
    runtime = built(4)
    for _ in range(3):
        runtime.tick()
    outside = np.tile(SPEC.joint_array("q_home"), (4, 1))
    outside[1, 0] = SPEC.joint_array("q_max")[0] + 0.02
    runtime.robot.reset(every(runtime), outside)
    runtime.reset(every(runtime))
    heard(runtime)
    runtime.state.housing_c[2, 4] = 95.0
    runtime.state.age[3] = 1.0
    refused = [Reason(int(r)) for r in runtime.arm(every(runtime))]
    assert refused == [Reason.NONE, Reason.POSITION | Reason.OUTSIDE, Reason.HEAT, Reason.STALE | Reason.LOST]
    assert runtime.supervisor.powered.tolist() == [True, False, False, False]


def test_a_robot_that_moves_is_not_armed():
    """Somebody leads it by hand, say, or its brake slips."""
    runtime = built(2)
    heard(runtime)
    runtime.estimator.joints.ed[1, 2] = 0.5
    refused = [Reason(int(r)) for r in runtime.arm(every(runtime))]
    assert refused == [Reason.NONE, Reason.MOVING]
    assert runtime.supervisor.powered.tolist() == [True, False]


def test_act_policy_sense_is_tick():
    """Training is no twin: a policy between the two halves moves the robot bit for bit as the shipped one does."""
    shipped, trained = running(3), running(3)
    for _ in range(300):
        shipped.tick()
        observation = trained.sense()
        trained.act(None if observation is None else trained.policy.step(observation))
        assert_same(shipped, trained)


def test_policy_steps_at_its_own_rate():
    runtime, asked = running(), []
    for _ in range(40):
        asked.append(runtime.sense() is not None)
        runtime.act(runtime.policy.step(runtime.observation.frames) if asked[-1] else None)
    ratio = SPEC.rates.control_hz // 50
    assert asked[asked.index(True) :: ratio] == [True] * len(asked[asked.index(True) :: ratio])
    assert sum(asked) == 40 // ratio


@pytest.mark.slow
def test_same_seeds_same_bits_other_seeds_other_bits():
    one, other, stranger = running(3), running(3), running(3, seed=6)
    for runtime in (one, other, stranger):
        play(runtime, 300)
    assert_same(one, other)
    assert (bits(one)["rows"] != bits(stranger)["rows"]).any(axis=1).all()


def test_threads_do_not_change_a_bit():
    one, two = running(5), running(5, threads=2)
    play(one, 200)
    play(two, 200)
    assert_same(one, two)


@pytest.mark.slow
def test_robot_alone_equals_the_same_robot_in_a_group():
    group = running(4)
    together, _ = play(group, 400)
    for robot in (0, 3):
        alone, _ = play(running(only=[robot]), 400)
        np.testing.assert_allclose(alone[:, 0], together[:, robot], rtol=0, atol=1e-6)


def test_broken_policy_and_stopped_robot_affect_no_other_robot():
    clean, broken = running(4), running(4)
    poison = Wandering(clean.contract)

    def step(observation, healthy=poison.step):
        action = healthy(observation)
        action[1] = np.nan
        return action

    broken.policy.step = step
    expected, _ = play(clean, 300)
    found, modes = play(broken, 300)
    others = [0, 2, 3]
    np.testing.assert_array_equal(found[:, others], expected[:, others])
    assert modes[-1, 1] == Mode.LATCHED


def save(runtime):
    """What a checkpoint must hold."""
    return runtime.save(), runtime.robot.save()


def restore(runtime, saved):
    own, backend = saved
    runtime.restore(own)
    runtime.robot.restore(backend)


@pytest.mark.parametrize("at", [50, 133])
@pytest.mark.slow
def test_saved_and_restored_goes_on_bit_for_bit(at):
    """Into a runtime that has lived another life; stops and stale samples on the way."""
    one, other = running(3), running(3)
    play(one, at)
    play(other, 260)
    restore(other, save(one))
    for tick in range(200):
        if tick == 60:
            for each in (one, other):
                each.stop(Reason.OPERATOR)
        one.tick()
        other.tick()
        assert_same(one, other)


def test_prepared_stop_is_part_of_the_saved_state():
    """Why `save` needs the prepared stop: refused in its first tick, the robot takes the stop of the tick before."""
    one, other = running(2), running(2)
    play(one, 60)
    play(other, 200)
    complete = save(one)
    for each in (one, other):
        each.stop(Reason.OPERATOR)
    own, backend = complete
    own["requested_stop"][:] = int(Reason.OPERATOR)
    still = {
        f"prepared_stop.{name}": getattr(other.prepared_stop.setpoint, name).copy()
        for name in ("q", "qd", "qdd")
    }
    restore(other, (own | still, backend))
    one.tick()
    other.tick()
    assert (one.command.q != other.command.q).any()


@pytest.mark.slow
def test_arm_with_policy_gains_is_checked_at_its_setpoint():
    """Down to the edge of its workspace: the guards of a walker, which look where joints are, would stop it above."""
    soft = arm_contract().action.model_copy(update={"kp": (2000.0,) * N, "kd": (100.0,) * N})
    policy = Saying(8)
    policy.action[:, 1] = 1.0
    runtime = running(8, policy=policy, contract=arm_contract(action=soft))
    fleet, heights = Fleet(SPEC, 8), []
    for _ in range(1100):
        runtime.tick()
        kinematics = fleet.kinematics(runtime.command.q)
        heights.append(kinematics.tool_position[:, 2].min())
        assert not runtime.robot.truth().self_collision.any()
    assert SPEC.workspace.z_min <= np.min(heights) < SPEC.workspace.z_min + 0.02


def test_commands_carry_the_gains_of_the_contract():
    soft = arm_contract().action.model_copy(update={"kp": (400.0,) * N, "kd": (40.0,) * N})
    for action, gains in ((soft, soft.gains), (arm_contract().action, drive_gains(SPEC))):
        runtime = running(2, contract=arm_contract(action=action))
        for found, expected in zip(runtime.command.drive[1:], gains, strict=True):
            np.testing.assert_array_equal(found, np.tile(expected, (2, 1)))
        assert (runtime.command.drive.mode == ControlMode.POSITION).all()


def test_reset_of_a_subset():
    runtime, twin = running(3), running(3)
    ids = np.array([False, True, False])
    for each in (runtime, twin):
        play(each, 100)
    pose = np.tile(POOL.q[77], (3, 1))
    runtime.robot.reset(ids, pose)
    runtime.reset(ids)
    ran = False
    for tick in range(120):
        for each in (runtime, twin):
            observation = each.sense()
            if each is runtime and tick >= 40 and not each.supervisor.powered[1]:
                assert not each.arm(ids).any()
            each.act(None if observation is None else each.policy.step(observation))
        np.testing.assert_array_equal(runtime.command.q[[0, 2]], twin.command.q[[0, 2]])
        ran |= runtime.supervisor.mode[1] == Mode.RUNNING
    assert ran
    assert not np.array_equal(runtime.task.goal[1], twin.task.goal[1])
