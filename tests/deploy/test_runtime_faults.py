"""What goes wrong in flight, and that the robot then stops as it should, and no other robot does."""

from itertools import pairwise

import numpy as np
import pytest

from deploy.backends.sim.sensor_faults import Failure, Fault
from deploy.motion.smoother import Smoother
from deploy.reasons import Reason
from deploy.sources.readings import SILENT_S
from deploy.state import Mode, Setpoint
from support.arm6 import SPEC
from support.runtimes import Saying, assert_same, assert_within_limits, every, play, running

N, DT = SPEC.n, SPEC.dt


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_policy_output_of_nan_stops_its_robot(bad):
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


def test_operator_stop_is_controlled_and_latches_until_arming():
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


BEGINS = 70
"""The tick at which sensors fail, with the robots well under way."""


def failing(what, ticks, *, channel=None, sensor="encoder"):
    """Two robots, of which the second has a sensor that fails for some ticks."""
    fault = Fault(robot=1, sensor=sensor, what=what, channel=channel, begins=BEGINS, ends=BEGINS + ticks)
    return running(2, faults=[fault])


def reasons_of(runtime, robot, ticks):
    """Commands, modes and reasons of some ticks; the reasons as safety and estimator have them, tick by tick."""
    q, modes, reasons = [], [], []
    for _ in range(ticks):
        runtime.tick()
        q.append(runtime.command.q.copy())
        modes.append(runtime.supervisor.mode.copy())
        reasons.append(Reason(int(runtime.verdict.reason[robot] | runtime.state.fault[robot])))
    return np.array(q), np.array(modes), reasons


def test_few_missing_packets_cause_no_stop():
    _, modes, reasons = reasons_of(failing(Failure.OFF, 3), 1, 150)
    assert (modes == Mode.RUNNING).all()
    assert not any(reasons)


def test_burst_of_losses_causes_a_hold_and_recovery():
    runtime = failing(Failure.OFF, 15)
    q, modes, reasons = reasons_of(runtime, 1, 300)
    first = next(i for i, reason in enumerate(reasons) if reason) + runtime.ticks - 300 - BEGINS
    assert 5 <= first <= 9  # packets on their way still arrive; five missing in a row
    assert any(Reason.STALE in reason for reason in reasons)
    assert not any(Reason.LOST in reason for reason in reasons)
    assert Mode.HOLDING in modes[:, 1]
    assert modes[-1, 1] == Mode.RUNNING
    assert Mode.LATCHED not in modes
    assert_within_limits(q)


def test_silence_latches_after_a_planned_stop():
    runtime = failing(Failure.OFF, 300)
    q, modes, reasons = reasons_of(runtime, 1, 250)
    first = (
        next(i for i, reason in enumerate(reasons) if Reason.LOST in reason) + runtime.ticks - 250 - BEGINS
    )
    assert 20 <= first <= 25  # twenty in a row
    assert modes[-1, 1] == Mode.LATCHED
    assert modes[-1, 0] == Mode.RUNNING
    assert_within_limits(q)
    only = np.array([False, True])
    assert Reason.LOST in Reason(int(runtime.arm(only)[1]))
    assert runtime.supervisor.mode[1] == Mode.LATCHED
    assert runtime.resting.ticks[1] == 0  # setpoints do not begin at estimates that no sample has corrected
    play(runtime, 200)
    assert runtime.resting.ticks[1] > 0
    assert not runtime.arm(only).any()
    assert (play(runtime, 40)[1] == Mode.RUNNING).any(axis=0).all()


def test_encoder_channel_of_nan_counts_as_silent():
    runtime = failing(Failure.OFF, 300, channel=3)
    q, modes, reasons = reasons_of(runtime, 1, 250)
    assert any(Reason.LOST in reason for reason in reasons)
    assert (modes[-1] == Mode.LATCHED).tolist() == [False, True]
    assert_within_limits(q)


STOPS = {
    Failure.OFF: Reason.LOST,
    Failure.STUCK: Reason.STUCK | Reason.LOST | Reason.TRACKING | Reason.DIVERGED,
    Failure.GARBAGE: Reason.LOST | Reason.DIVERGED,
    Failure.WRONG: Reason.LOST | Reason.DIVERGED,
    Failure.SLOW: Reason.STALE,
    Failure.DELAYED: Reason.LOST,
    Failure.INTERMITTENT: Reason.LOST,
}
"""One of these must stop a robot whose encoder fails so; slow packets let it stop and go."""


@pytest.mark.parametrize("what", Failure)
@pytest.mark.slow
def test_every_encoder_fault_stops_the_robot_within_limits(what):
    """And no other robot; until then the estimate stays near the truth."""
    runtime = failing(what, 400)
    q, modes, reasons, errors = [], [], Reason.NONE, []
    for _ in range(350):
        runtime.tick()
        q.append(runtime.command.q.copy())
        modes.append(runtime.supervisor.mode.copy())
        reasons |= Reason(int(runtime.verdict.reason[1] | runtime.state.fault[1]))
        if modes[-1][1] == Mode.RUNNING:
            errors.append(np.abs(runtime.state.q - runtime.robot.truth().q)[1].max())
    assert reasons & STOPS[what]
    assert (np.array(modes)[:, 0] == Mode.RUNNING).all()
    assert (np.array(modes)[:, 1] != Mode.RUNNING).any()
    # the angle at which TRACKING stops a robot, and what the joint moves until the next tick
    of_a_period = SPEC.margins.speed * SPEC.joint_array("qd_max").max() * SPEC.dt
    assert max(errors) < SPEC.margins.tracking_rad + of_a_period
    assert_within_limits(np.array(q))


@pytest.mark.parametrize("sensor", ["current", "temperature", "force", "goal"])
@pytest.mark.parametrize("what", Failure)
@pytest.mark.slow
def test_faults_of_other_sensors_break_no_limit(sensor, what):
    """Whether it stops or not: commands stay finite and within the limits, and the neighbour does not notice."""
    runtime, clean = failing(what, 300, sensor=sensor), running(2)
    q, _ = play(runtime, 200)
    assert np.isfinite(q).all()
    assert_within_limits(q)
    np.testing.assert_array_equal(q[:, 0], play(clean, 200)[0][:, 0])


def test_lost_goal_is_replaced_by_the_tool_position():
    runtime = failing("off", 10_000, sensor="goal")
    play(runtime, round((SILENT_S + 0.5) / SPEC.dt))
    away = np.linalg.norm(runtime.task.camera_goal - runtime.tool.position, axis=1)
    assert away[0] > 0.01
    assert away[1] == 0.0


def test_missing_plan_cuts_power_and_sends_no_nan(monkeypatch):
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
    runtime.robot.plant.housing[1, 2] = 95.0
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


def test_nan_is_refused_even_by_disabled_checks(monkeypatch):
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


def test_checked_stop_begins_at_the_setpoint(monkeypatch):
    """Its first step, moments while it brakes, and where it ends."""
    runtime, asked = running(2), []
    judged = runtime.safety.step

    def listen(*what):
        _, sent, planned, checked = what
        asked.append([np.copy(pose) for pose in (planned.q, checked.ahead.q, *checked.q, checked.q_rest)])
        stop = Smoother(SPEC, 2).brake(planned)
        np.testing.assert_array_equal(checked.ahead.q, stop.ahead.q)
        for name in ("q", "qd", "q_rest"):
            np.testing.assert_array_equal(getattr(checked, name), getattr(stop, name))
        assert planned is not sent
        return judged(*what)

    monkeypatch.setattr(runtime.safety, "step", listen)
    play(runtime, 60)
    for one, other in pairwise(np.array(asked).swapaxes(0, 1)):
        assert (np.abs(one - other).max(axis=(1, 2)) > 1e-6).sum() > 20


def test_a_diverged_simulation_stops_its_robot_only():
    clean, broken = running(3), running(3)
    broken.robot.plant.rows[1] = np.nan
    with np.errstate(invalid="ignore"):
        for _ in range(100):
            clean.tick()
            broken.tick()
    assert broken.robot.truth().valid.tolist() == [True, False, True]
    np.testing.assert_array_equal(broken.robot.plant.rows[[0, 2]], clean.robot.plant.rows[[0, 2]])


@pytest.mark.parametrize("number", [1e160, -1e308])
@pytest.mark.parametrize("name", ["encoder", "current"])
def test_a_number_that_no_sensor_measures_stops_its_robot_only(monkeypatch, name, number):
    """It ends no tick, even where numpy's warnings are errors, as they are here."""
    runtime = running(3, policy=Saying(3))
    read = runtime.robot.read

    def wrong():
        sample = dict(read())
        value = sample[name].value.copy()
        value[1, 2] = number
        sample[name] = sample[name]._replace(value=value)
        return sample

    monkeypatch.setattr(runtime.robot, "read", wrong)
    _, modes = play(runtime, 150)
    assert (modes[:, [0, 2]] == Mode.RUNNING).all()
    assert modes[-1, 1] == Mode.LATCHED


@pytest.mark.parametrize("told", [True, False])
def test_after_a_late_tick_at_speed_the_samples_of_a_robot_are_used_if_its_runtime_is_told(told):
    """The drive has come to rest meanwhile, and catches up; without being told the estimator refuses its samples for
    about as long as stops a robot."""
    policy = Saying(4)
    runtime = running(4, policy=policy)
    policy.action[:, 0] = 1.0
    play(runtime, 60)
    assert (runtime.command.qd[:, 0] > 1.5).all()
    late = np.array([10, 10, 10, 0])
    runtime.robot.plant.late[:] = late
    if told:
        runtime.skip(late)
    oldest = np.zeros(4)
    for _ in range(20):
        runtime.tick()
        oldest = np.maximum(oldest, runtime.state.age)
    assert (oldest[:3] < 0.02).all() == told
    assert (oldest[:3] > SPEC.margins.stale_s - SPEC.dt).all() != told
    assert oldest[3] < 0.02
    assert runtime.supervisor.running[3]
    assert runtime.supervisor.running.all() or not told
