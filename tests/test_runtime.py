import numpy as np
import pytest
from test_contract import arm_contract
from test_spec import SPEC

from deploy.runtime import Runtime
from deploy.smoother import Smoother
from deploy.state import Mode, Reason, Setpoint
from deploy.tasks import reach
from deploy.tasks.reach import ReachConfig, goal_pool
from robots.randomness import robot_seed

SimRobot = pytest.importorskip("deploy.backends.sim.robot").SimRobot

N, DT = SPEC.n, SPEC.dt
POOL = goal_pool(SPEC, ReachConfig())
STAGES = ("estimator", "action", "smoother", "supervisor", "task", "observation")
OWN = ("asked", "_tau_ahead", "_tool")


@pytest.fixture(autouse=True)
def one_pool(monkeypatch):
    """Every task samples the same pool: once is enough."""
    monkeypatch.setattr(reach, "goal_pool", lambda spec, config: POOL)


class Wandering:
    """A policy without a purpose: a fixed random function of the observation."""

    def __init__(self, contract, seed=0, gain=2.0):
        rng = np.random.default_rng(seed)
        self.weights = gain * rng.normal(size=(contract.observation_size, contract.action_size)).astype(
            np.float32
        )

    def step(self, observation):
        # Row by row: a matrix product may depend on its width in the last bit.
        return np.stack([np.tanh((row[:, None] * self.weights).sum(axis=0)) for row in observation])


class Saying:
    """A policy that says what it is told to."""

    def __init__(self, robots):
        self.action = np.zeros((robots, N))

    def step(self, observation):
        return self.action


def built(robots=2, seed=5, *, policy=None, threads=1, only=None, contract=None):
    """A runtime on simulated robots, not yet armed; also for other test files."""
    contract = contract or arm_contract()
    seeds = [robot_seed(seed, robot) for robot in (range(robots) if only is None else only)]
    robot = SimRobot(SPEC, seeds, threads=threads)
    return Runtime(SPEC, contract, robot, seeds, policy or Wandering(contract))


def every(runtime, value=True):
    return np.full(runtime.robot.robots, value)


def running(robots=2, seed=5, **how):
    """The same, armed and under way."""
    runtime = built(robots, seed, **how)
    runtime.sense()
    assert not runtime.arm(every(runtime)).any()
    runtime.act(None)
    for _ in range(24):
        runtime.tick()
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    return runtime


def play(runtime, ticks):
    """Every command sent, angles (T, B, n), and every mode (T, B)."""
    q, modes = [], []
    for _ in range(ticks):
        runtime.tick()
        assert np.isfinite(runtime.command.q + runtime.command.qd + runtime.command.tau).all()
        q.append(runtime.command.q.copy())
        modes.append(runtime.supervisor.mode.copy())
    return np.array(q), np.array(modes)


def bits(runtime):
    """Everything that a tick leaves behind."""
    truth = runtime.robot.truth()
    return {
        "rows": runtime.robot.plant.rows.copy(),
        "command": np.stack((runtime.command.q, runtime.command.qd, runtime.command.tau)),
        "state": np.stack((runtime.state.q, runtime.state.qd)),
        "verdict": runtime.verdict.reason.copy(),
        "goal": runtime.task.goal.copy(),
        "mode": runtime.supervisor.mode.copy(),
        "frames": runtime.observation.frames.copy(),
        "housing": truth.housing_c.copy(),
    }


def assert_same(one, other):
    for name, array in bits(one).items():
        np.testing.assert_array_equal(bits(other)[name], array, err_msg=name)


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
    runtime.sense()
    assert not runtime.arm(every(runtime)).any()
    before = runtime.state.q.copy()
    runtime.act(None)
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


def test_refuses_to_arm_with_reasons():
    runtime = built(4)
    for _ in range(3):
        runtime.tick()
    outside = np.tile(SPEC.joint_array("q_home"), (4, 1))
    outside[1, 0] = SPEC.joint_array("q_max")[0] + 0.02
    runtime.robot.reset(every(runtime), outside)
    runtime.reset(every(runtime))
    runtime.sense()
    runtime.state.temperature[2, 4] = 95.0
    runtime.state.age[3] = 1.0
    refused = [Reason(int(r)) for r in runtime.arm(every(runtime))]
    assert refused == [Reason.NONE, Reason.POSITION | Reason.OUTSIDE, Reason.HEAT, Reason.STALE | Reason.LOST]
    assert runtime.supervisor.powered.tolist() == [True, False, False, False]


def test_act_policy_sense_is_tick():
    """Training is no twin: a policy between the two halves moves the robot bit for bit as the shipped one does."""
    shipped, trained = running(3), running(3)
    for _ in range(300):
        shipped.tick()
        observation = trained.sense()
        trained.act(None if observation is None else trained.policy.step(observation))
        assert_same(shipped, trained)


def test_the_policy_is_asked_at_its_own_rate():
    runtime, asked = running(), []
    for _ in range(40):
        asked.append(runtime.sense() is not None)
        runtime.act(runtime.policy.step(runtime.observation.frames) if asked[-1] else None)
    ratio = SPEC.rates.control_hz // 50
    assert asked[asked.index(True) :: ratio] == [True] * len(asked[asked.index(True) :: ratio])
    assert sum(asked) == 40 // ratio


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


def test_a_robot_alone_goes_the_way_it_goes_in_a_group():
    group = running(4)
    together, _ = play(group, 400)
    for robot in (0, 3):
        alone, _ = play(running(only=[robot]), 400)
        np.testing.assert_allclose(alone[:, 0], together[:, robot], rtol=0, atol=1e-6)


def test_neither_a_broken_policy_nor_a_stopped_robot_disturbs_its_neighbours():
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


def assert_within_limits(q):
    """By backward differences of what was sent, (T, B, n)."""
    derivative = q
    for name, share in (("qd_max", SPEC.margins.speed), ("qdd_max", 1.0), ("qddd_max", 1.0)):
        derivative = np.diff(derivative, axis=0) / DT
        assert (np.abs(derivative) <= share * SPEC.joint_array(name) * (1 + 1e-4)).all(), name


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_policy_that_says_nan_stops_its_robot(bad):
    robots, policy = 3, Saying(3)
    runtime = running(robots, policy=policy)
    policy.action[:] = np.random.default_rng(0).uniform(-1, 1, (robots, N))
    before, _ = play(runtime, 60)
    assert np.abs(runtime.command.qd).max() > 0.3
    policy.action[1, 4] = bad
    after, modes = play(runtime, 200)
    assert_within_limits(np.concatenate((before, after)))
    assert (modes[-1] == Mode.LATCHED).tolist() == [False, True, False]
    assert runtime.supervisor.reason[1] & Reason.NOT_FINITE
    stopped = np.flatnonzero(modes[:, 1] == Mode.LATCHED)[0]
    np.testing.assert_array_equal(
        after[stopped:, 1], np.broadcast_to(after[stopped, 1], after[stopped:, 1].shape)
    )
    assert not runtime.command.powered[1]
    policy.action[1, 4] = 0.0
    assert (play(runtime, 100)[1][:, 1] == Mode.LATCHED).all()


def test_an_operators_stop_is_controlled_latches_and_is_taken_back_by_arming():
    runtime = running(3)
    before, _ = play(runtime, 60)
    runtime.stop(Reason.OPERATOR)
    after, modes = play(runtime, 200)
    assert_within_limits(np.concatenate((before, after)))
    assert (modes[0] == Mode.STOPPING).all()
    assert (modes[-1] == Mode.LATCHED).all()
    assert (runtime.supervisor.reason & Reason.OPERATOR).all()
    assert not runtime.command.powered.any()
    assert not runtime.arm(every(runtime)).any()
    _, modes = play(runtime, 60)
    assert (modes == Mode.RUNNING).any(axis=0).all()


def test_arming_a_moving_robot_does_nothing():
    """The operator presses the button twice: no jump, and a stop that is under way goes on to its end."""
    runtime, twin = running(3), running(3)
    for each in (runtime, twin):
        play(each, 60)
    runtime.arm(every(runtime))
    assert_same(runtime, twin)
    for each in (runtime, twin):
        each.stop(Reason.OPERATOR)
        play(each, 3)
    assert (runtime.supervisor.mode == Mode.STOPPING).all()
    runtime.arm(every(runtime))
    np.testing.assert_array_equal(play(runtime, 150)[0], play(twin, 150)[0])
    assert (runtime.supervisor.mode == Mode.LATCHED).all()


def silence(runtime, robot, ticks, monkeypatch):
    """No packet of one robot for some ticks; the commands, modes and reasons of this time."""
    sensors, read = runtime.robot.sensors, runtime.robot.sensors.read

    def lossy(current, temperature):
        held = sensors.q[robot].copy(), sensors.t[robot]
        sample = read(current, temperature)
        sample.fresh[robot] = False
        sample.q[robot], sample.t[robot] = held
        return sample

    q, modes, reasons = [], [], []
    with monkeypatch.context() as patch:
        patch.setattr(sensors, "read", lossy)
        for _ in range(ticks):
            runtime.tick()
            q.append(runtime.command.q.copy())
            modes.append(runtime.supervisor.mode[robot])
            reasons.append(Reason(int(runtime.verdict.reason[robot])))
    return np.array(q), modes, reasons


def test_few_missing_packets_are_ridden_through(monkeypatch):
    runtime = running(2)
    play(runtime, 40)
    _, modes, reasons = silence(runtime, 1, 4, monkeypatch)
    assert set(modes) == {Mode.RUNNING}
    assert not any(reasons)


def test_a_burst_of_losses_makes_it_hold_and_go_on(monkeypatch):
    runtime = running(2)
    before, _ = play(runtime, 40)
    q, modes, reasons = silence(runtime, 1, 15, monkeypatch)
    assert Reason.STALE in reasons[-1]
    assert Reason.LOST not in reasons[-1]
    assert modes[-1] in (Mode.STOPPING, Mode.HOLDING)
    first = modes.index(Mode.STOPPING)
    assert 4 <= first <= 8  # about five packets in a row
    after, modes = play(runtime, 200)
    assert modes[-1, 1] == Mode.RUNNING
    assert Mode.LATCHED not in modes
    assert_within_limits(np.concatenate((before, q, after)))


def test_silence_latches_after_a_stop_on_the_planned_way(monkeypatch):
    runtime = running(2)
    before, _ = play(runtime, 40)
    q, modes, reasons = silence(runtime, 1, 160, monkeypatch)
    assert 18 <= next(i for i, r in enumerate(reasons) if Reason.LOST in r) <= 22  # twenty in a row
    assert modes[-1] == Mode.LATCHED
    assert_within_limits(np.concatenate((before, q)))
    assert Reason.LOST in Reason(int(runtime.arm(every(runtime))[1]))
    assert runtime.supervisor.mode[1] == Mode.LATCHED
    play(runtime, 20)
    assert not runtime.arm(np.array([False, True])).any()
    assert (play(runtime, 40)[1] == Mode.RUNNING).any(axis=0).all()


def test_an_encoder_that_says_nan_is_an_encoder_that_is_silent(monkeypatch):
    runtime = running(3)
    before, _ = play(runtime, 40)
    sensors, read = runtime.robot.sensors, runtime.robot.sensors.read

    def broken(current, temperature):
        sample = read(current, temperature)
        sample.fresh[1], sample.t[1] = True, runtime.t
        sample.q[1, 3] = np.nan
        return sample

    only = np.array([False, True, False])
    monkeypatch.setattr(sensors, "read", broken)
    q, modes = play(runtime, 200)
    assert modes[-1, 1] == Mode.LATCHED
    assert (modes[:, [0, 2]] != Mode.LATCHED).all()
    assert_within_limits(np.concatenate((before, q)))
    assert Reason.LOST in Reason(int(runtime.arm(only)[1]))
    monkeypatch.setattr(sensors, "read", read)
    play(runtime, 20)
    assert not runtime.arm(only).any()


def test_no_plan_at_all_cuts_power_and_sends_no_nan(monkeypatch):
    runtime = running(3)
    play(runtime, 40)
    smoother, here = runtime.smoother, runtime.command.q[1].copy()

    def without(call):
        def planless(*args):
            plan = call(*args)
            setpoint = plan if isinstance(plan, Setpoint) else plan[0]
            for part in (setpoint.q, setpoint.qd, setpoint.qdd):
                part[1] = np.nan
            return plan

        return planless

    monkeypatch.setattr(smoother, "next", without(smoother.next))
    monkeypatch.setattr(smoother, "brake", without(smoother.brake))
    q, modes = play(runtime, 20)
    assert modes[-1, 1] == Mode.LATCHED
    assert (modes[:, [0, 2]] != Mode.LATCHED).all()
    assert runtime.supervisor.reason[1] & Reason.NOT_FINITE
    assert np.abs(q[:, 1] - here).max() < 0.05


def test_a_hot_housing_stops_its_robot():
    runtime = running(2)
    runtime.robot.plant.housing[1, 2] = 85.0
    _, modes = play(runtime, 150)
    assert (modes[-1] == Mode.LATCHED).tolist() == [False, True]
    assert runtime.supervisor.reason[1] & Reason.HEAT


def test_a_joint_that_does_not_follow_stops_its_robot():
    runtime = running(2)
    play(runtime, 20)
    runtime.robot.plant.batch.expand("dof_frictionloss")[1, 0] = 1e5
    policy = Saying(2)
    policy.action[:, 0] = 1.0
    runtime.policy = policy
    _, modes = play(runtime, 200)
    assert modes[-1, 1] == Mode.LATCHED
    assert runtime.supervisor.reason[1] & Reason.TRACKING


@pytest.mark.parametrize("stopping_for", [0, 10])
def test_a_setpoint_without_a_plan_is_never_sent(stopping_for, monkeypatch):
    """Were planning to fail, before a stop or in it, what is sent stays finite and the robot ends without power."""
    runtime, calls = running(3), []
    before, _ = play(runtime, 40)
    if stopping_for:
        runtime.stop(Reason.OPERATOR)
        before = np.concatenate((before, play(runtime, stopping_for)[0]))
    planned = runtime.smoother.next

    def without_a_plan(q_target, stopping):
        setpoint = planned(q_target, stopping)
        if not calls:
            setpoint.q[1], setpoint.qd[1], setpoint.qdd[1] = np.nan, np.nan, np.nan
        calls.append(None)
        return setpoint

    monkeypatch.setattr(runtime.smoother, "next", without_a_plan)
    with np.errstate(invalid="ignore"):
        after, modes = play(runtime, 150)
    assert_within_limits(np.concatenate((before, after)))
    assert modes[-1, 1] == Mode.LATCHED
    assert not runtime.command.powered[1]
    assert (modes[-1, [0, 2]] == Mode.LATCHED).all() == bool(stopping_for)


def test_even_blind_checks_let_no_nan_through(monkeypatch):
    """The last barrier before the bus asks nobody."""
    runtime = running(3)
    play(runtime, 40)
    planned, judged = runtime.smoother.next, runtime.safety.step

    def planless(q_target, stopping):
        setpoint = planned(q_target, stopping)
        setpoint.q[1], setpoint.qd[1], setpoint.qdd[1] = np.nan, np.nan, np.nan
        return setpoint

    def blind(*asked):
        return judged(*asked)._replace(reason=np.zeros(3, dtype=np.int64))

    monkeypatch.setattr(runtime.smoother, "next", planless)
    monkeypatch.setattr(runtime.safety, "step", blind)
    for _ in range(5):
        runtime.tick()
        command = runtime.command
        assert np.isfinite(command.q).all()
        assert np.isfinite(command.qd).all()
        assert np.isfinite(command.tau).all()
    assert runtime.robot.truth().valid.all()


def test_what_is_judged_is_the_stop_that_would_begin_at_the_setpoint(monkeypatch):
    """Its first step, a pose in its midst, and where it ends."""
    runtime, asked = running(2), []
    judged = runtime.safety.step

    def listen(*what):
        asked.append([np.copy(pose) for pose in (what[2].q, what[3].q, what[4], what[5])])
        planned, stop = what[2], Smoother(SPEC, 2).brake(what[2])
        np.testing.assert_array_equal(what[3].q, stop[0].q)
        np.testing.assert_array_equal(what[4], stop[1])
        np.testing.assert_array_equal(what[5], stop[2])
        assert planned is not what[1]
        return judged(*what)

    monkeypatch.setattr(runtime.safety, "step", listen)
    play(runtime, 60)
    setpoint, ahead, midst, rest = np.array(asked).swapaxes(0, 1)
    for one, other in ((setpoint, ahead), (ahead, midst), (midst, rest)):
        assert (np.abs(one - other).max(axis=(1, 2)) > 1e-6).sum() > 20


def test_a_diverged_simulation_stops_its_robot_only():
    clean, broken = running(3), running(3)
    broken.robot.plant.qd[1] = np.nan
    with np.errstate(invalid="ignore"):
        for _ in range(100):
            clean.tick()
            broken.tick()
    assert broken.robot.truth().valid.tolist() == [True, False, True]
    np.testing.assert_array_equal(broken.robot.plant.rows[[0, 2]], clean.robot.plant.rows[[0, 2]])


def save(runtime):
    """What a checkpoint must hold."""
    stages = {name: getattr(runtime, name).save() for name in STAGES}
    own = {name: getattr(runtime, name).copy() for name in OWN}
    ahead = {name: getattr(runtime._ahead, name).copy() for name in ("q", "qd", "qdd")}
    backend = runtime.robot.plant.save(), runtime.robot.sensors.save()
    return stages, own, ahead, backend, runtime.ticks


def restore(runtime, saved):
    stages, own, ahead, backend, runtime.ticks = saved
    for name, arrays in stages.items():
        getattr(runtime, name).restore(arrays)
    for name, array in own.items():
        getattr(runtime, name)[...] = array
    runtime._ahead = type(runtime.smoother.sent)(**ahead)
    runtime.robot.plant.restore(backend[0])
    runtime.robot.sensors.restore(backend[1])


@pytest.mark.parametrize("at", [50, 133])
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


def test_without_the_prepared_stop_a_restored_runtime_would_stop_elsewhere():
    """Why `save` above needs `_ahead`: refused in its first tick, the robot takes the stop of the tick before."""
    one, other = running(2), running(2)
    play(one, 60)
    play(other, 200)
    complete = save(one)
    for each in (one, other):
        each.stop(Reason.OPERATOR)
    stages, own, _, backend, ticks = complete
    own["asked"][:] = int(Reason.OPERATOR)
    still = {name: getattr(other._ahead, name).copy() for name in ("q", "qd", "qdd")}
    restore(other, (stages, own, still, backend, ticks))
    one.tick()
    other.tick()
    assert (one.command.q != other.command.q).any()


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
            if each is runtime and tick >= 2 and not each.supervisor.powered[1]:
                assert not each.arm(ids).any()
            each.act(None if observation is None else each.policy.step(observation))
        np.testing.assert_array_equal(runtime.command.q[[0, 2]], twin.command.q[[0, 2]])
        ran |= runtime.supervisor.mode[1] == Mode.RUNNING
    assert ran
    assert not np.array_equal(runtime.task.goal[1], twin.task.goal[1])
