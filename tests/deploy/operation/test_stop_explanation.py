"""Which joint or shapes a reason is about."""

import numpy as np
import pytest

from deploy.reasons import REASONS, Reason
from deploy.state import STOP_MOMENTS, Mode
from support.arm6 import SPEC
from support.deploy.safety import stop_at

pytest.importorskip("mujoco")

from deploy.estimation.joint_filter import NIS_MAX
from deploy.operation.stop_explanation import StopDetector, StopExplanation, explain_reasons
from support.runtimes import built, heard, running
from support.walking import standing

WRIST = SPEC.joint_names.index("wrist_2")


@pytest.fixture
def runtime():
    return running(2)


def beyond(runtime, robot=0):
    runtime.state.q[robot, WRIST] = SPEC.joints[WRIST].q_max + 0.01


def astray(runtime, robot=0):
    runtime.state.q[robot, WRIST] = runtime.setpoint.q[robot, WRIST] + 1.1 * SPEC.margins.tracking_rad


def hot(runtime, robot=0):
    runtime.state.housing_c[robot, WRIST] = 500.0


def lost(runtime, robot=0):
    runtime.estimator.joints.nis[robot, WRIST] = NIS_MAX + 1


def hanging(runtime, robot=0):
    detection = runtime.estimator.stuck_detection
    detection.repeats[robot] = 10**6  # as at rest: nobody was sent away
    detection.setpoint[robot] = runtime.estimator.setpoints.q[robot]
    detection.setpoint[robot, WRIST] += 0.1


def leaning(runtime, robot=0):
    detection = runtime.estimator.external_torque
    detection.packets[robot, WRIST] = detection.packets_min


def shaking(runtime, robot=0):
    runtime.estimator.oscillation.count[robot, WRIST] = 1e3


def moving(runtime, robot=0):
    runtime.estimator.joints.ed[robot, WRIST] = 10.0


@pytest.mark.parametrize(
    ("befall", "reason"),
    [
        (beyond, Reason.OUTSIDE),
        (astray, Reason.TRACKING),
        (hot, Reason.HEAT),
        (lost, Reason.DIVERGED),
        (hanging, Reason.STUCK),
        (leaning, Reason.LOAD),
        (shaking, Reason.OSCILLATION),
        (moving, Reason.MOVING),
    ],
)
@pytest.mark.parametrize("robot", range(2))
def test_a_reason_names_its_joint(runtime, befall, reason, robot):
    assert explain_reasons(runtime, int(reason), robot) == REASONS[reason].text
    befall(runtime, robot)
    runtime.act(None)
    assert explain_reasons(runtime, int(reason), robot) == f"{REASONS[reason].text} (wrist_2)"
    assert explain_reasons(runtime, int(reason), 1 - robot) == REASONS[reason].text


@pytest.mark.parametrize(
    ("part", "value", "reason"),
    [("q", 10.0, Reason.POSITION), ("qd", 50.0, Reason.VELOCITY), ("qdd", 1e4, Reason.TORQUE)],
)
def test_refused_setpoint_names_its_joint_for_its_robot_only(runtime, part, value, reason):
    planned = runtime.setpoint
    getattr(planned, part)[1, WRIST] += value
    runtime.verdict = runtime.safety.step(runtime.state, runtime.setpoint, planned, stop_at(planned))
    assert runtime.verdict.reason[1] & reason
    assert "wrist_2" in explain_reasons(runtime, int(reason), robot=1)
    assert explain_reasons(runtime, int(reason)) == REASONS[reason].text


@pytest.mark.parametrize("late", range(2))
def test_refused_stop_names_its_joint(runtime, late):
    """What would be sent, or what comes after it."""
    here = runtime.setpoint
    points = [here._replace(qd=here.qd.copy()) for _ in range(2)]
    points[late].qd[1, WRIST] = 50.0
    runtime.verdict = runtime.safety.step(
        runtime.state, here, points[0], stop_at(here)._replace(ahead=points[1])
    )
    assert (
        explain_reasons(runtime, int(Reason.VELOCITY), robot=1)
        == f"{REASONS[Reason.VELOCITY].text} (wrist_2)"
    )


@pytest.mark.parametrize("reason", [Reason.STALE, Reason.LOST])
def test_joint_with_an_invalid_estimate_is_named(runtime, reason):
    """Its readings come, and are refused one by one."""
    read = runtime.robot.read

    def astray():
        sample = read()
        sample["encoder"].value[1, WRIST] += np.random.default_rng(runtime.ticks).uniform(-1.0, 1.0)
        return sample

    runtime.robot.read = astray
    while not runtime.verdict.reason[1] & reason:
        runtime.tick()
    assert explain_reasons(runtime, int(reason), robot=1) == f"{REASONS[reason].text} (wrist_2)"


@pytest.mark.parametrize("reason", [Reason.STALE, Reason.LOST])
def test_silent_imu_is_named(reason):
    runtime = standing(2)
    read = runtime.robot.read

    def silent():
        sample = read()
        gyro = sample["gyro"]
        return sample | {"gyro": gyro._replace(fresh=gyro.fresh & [True, False])}

    runtime.robot.read = silent
    while not runtime.verdict.reason[1] & reason:
        runtime.tick()
    assert explain_reasons(runtime, int(reason), robot=1) == f"{REASONS[reason].text} (IMU)"
    assert explain_reasons(runtime, int(reason), robot=0) == REASONS[reason].text


@pytest.mark.parametrize("robot", range(2))
def test_diverged_base_estimate_is_named(robot):
    runtime = standing(2)
    runtime.capabilities.by_name["floating_base"].filter.P[robot] *= 1e6
    runtime.tick()
    assert explain_reasons(runtime, int(Reason.DIVERGED), robot) == f"{REASONS[Reason.DIVERGED].text} (base)"
    assert explain_reasons(runtime, int(Reason.DIVERGED), 1 - robot) == REASONS[Reason.DIVERGED].text


def test_a_fall_names_its_check_and_joint():
    """Several checks have that reason, of the base and of joints."""
    runtime = standing(2)
    runtime.state.qd[1, 2] = 1e3
    runtime.act(None)
    joint = runtime.spec.joint_names[2]
    text = explain_reasons(runtime, int(Reason.FALLEN), 1)
    assert text == f"{REASONS[Reason.FALLEN].text} ({joint}, joint_gives_way, joint_runs_away)"
    assert explain_reasons(runtime, int(Reason.FALLEN), 0) == REASONS[Reason.FALLEN].text


def test_power_loss_while_running_counts_as_a_stop(runtime):
    stops = StopDetector()
    assert stops.step(runtime) == []
    runtime.supervisor.latch(np.array([False, True]), Reason.OPERATOR)
    assert stops.step(runtime) == [1]
    assert stops.step(runtime) == []
    runtime.stop(Reason.OPERATOR)
    runtime.tick()
    assert stops.step(runtime) == [0]


def test_power_loss_while_arming_counts_as_a_stop(runtime):
    stops = StopDetector()
    runtime.supervisor.mode[:] = Mode.ARMING
    assert stops.step(runtime) == []
    runtime.supervisor.latch(np.array([True, False]), Reason.FALLEN)
    assert stops.step(runtime) == [0]


def test_joint_with_nan_is_named(runtime):
    runtime.state.q[0, WRIST] = np.nan
    runtime.act(None)
    assert explain_reasons(runtime, int(Reason.NOT_FINITE)) == f"{REASONS[Reason.NOT_FINITE].text} (wrist_2)"


def test_planned_joint_with_nan_is_named_despite_nan_torques(runtime):
    here = runtime.setpoint
    planned = here._replace(q=here.q.copy())
    planned.q[1, WRIST] = np.nan
    runtime.verdict = runtime.safety.step(runtime.state, here, planned, stop_at(here))
    assert np.isnan(runtime.verdict.tau[1]).all()
    assert (
        explain_reasons(runtime, int(Reason.NOT_FINITE), robot=1)
        == f"{REASONS[Reason.NOT_FINITE].text} (wrist_2)"
    )


@pytest.mark.parametrize("place", range(STOP_MOMENTS + 2))
@pytest.mark.parametrize(
    ("q", "shapes"),
    [
        ((0.3, -1.59, 2.64, 0.24, -1.16, 0.87), "upper_arm and wrist_3"),
        ((-0.04, -0.53, 2.5, -1.82, -1.4, -1.03), "table and wrist_2"),
    ],
)
def test_colliding_shapes_are_named(runtime, place, q, shapes):
    """Be it at the setpoint, while the stop brakes or at its end."""
    here = runtime.setpoint
    poses = np.array([here.q] * (STOP_MOMENTS + 2))
    poses[place, 0] = q
    stop = stop_at(here)._replace(q=poses[1:-1], q_rest=poses[-1])
    runtime.verdict = runtime.safety.step(runtime.state, here, here._replace(q=poses[0]), stop)
    assert explain_reasons(runtime, int(Reason.COLLISION)) == f"{REASONS[Reason.COLLISION].text} ({shapes})"
    assert explain_reasons(runtime, int(Reason.COLLISION), robot=1) == REASONS[Reason.COLLISION].text


def test_pose_of_nan_names_no_collision(runtime):
    here = runtime.setpoint
    stop = stop_at(here)._replace(q_rest=np.tile((0.3, -1.59, 2.64, 0.24, -1.16, 0.87), (2, 1)))
    stop.q[1, 0] = np.nan
    runtime.verdict = runtime.safety.step(runtime.state, here, here, stop)
    assert explain_reasons(runtime, int(Reason.COLLISION)).endswith("(upper_arm and wrist_3)")


def test_separate_shapes_are_not_named_for_a_pose_of_nan(runtime):
    here, nowhere = runtime.setpoint, np.full_like(runtime.setpoint.q, np.nan)
    one = here.q.copy()
    one[0, WRIST] = np.nan
    for planned, midst in ((nowhere, nowhere), (one, here.q)):
        stop = stop_at(here)._replace(q=np.array([here.q] * (STOP_MOMENTS - 1) + [midst]), q_rest=planned)
        runtime.verdict = runtime.safety.step(runtime.state, here, here._replace(q=planned), stop)
        assert runtime.verdict.reason[0] & Reason.COLLISION
        assert explain_reasons(runtime, int(Reason.COLLISION)) == REASONS[Reason.COLLISION].text


@pytest.mark.parametrize("value", [np.nan, 0.7])
def test_silent_motor_is_named(runtime, value):
    read = runtime.robot.read

    def deaf():
        sample = read()
        sample["current"].value[0, WRIST] = value  # none, or always the same
        return sample

    runtime.robot.read = deaf
    while not runtime.estimator.windings.unknown.any():
        runtime.tick()
    assert runtime.supervisor.reason[0] & Reason.HEAT
    assert explain_reasons(runtime, int(Reason.HEAT)) == f"{REASONS[Reason.HEAT].text} (wrist_2)"


def test_reason_is_described_from_the_tick_in_which_it_came(runtime):
    why = StopExplanation()
    why.step(runtime)
    assert str(why) == ""
    q = runtime.state.q[0, WRIST]
    astray(runtime)
    runtime.act(None)
    why.step(runtime)
    runtime.state.q[0, WRIST] = q
    runtime.supervisor.reason[0] |= np.int64(Reason.OPERATOR)
    runtime.act(None)
    why.step(runtime)
    assert explain_reasons(runtime, int(Reason.TRACKING)) == REASONS[Reason.TRACKING].text  # not any more
    assert str(why) == f"{REASONS[Reason.TRACKING].text} (wrist_2); {REASONS[Reason.OPERATOR].text}"
    runtime.supervisor.reason[0] = 0
    why.step(runtime)
    assert str(why) == ""


@pytest.mark.parametrize("reason", list(Reason))
def test_every_reason_has_a_description(runtime, reason):
    assert explain_reasons(runtime, int(reason)).startswith(REASONS[reason].text)


def test_several_reasons_are_listed_in_order(runtime):
    beyond(runtime)
    runtime.act(None)
    said = explain_reasons(runtime, int(Reason.STALE | Reason.OUTSIDE))
    assert said == "sensor samples are missing; a joint is outside its working range (wrist_2)"


def test_nothing_is_known_before_the_first_packet():
    runtime = built(1)
    runtime.tick()
    assert explain_reasons(runtime, int(Reason.HEAT | Reason.OUTSIDE)).count("(") == 0


def test_refused_arming_names_the_moving_joint():
    runtime = built(1)
    heard(runtime)
    runtime.estimator.joints.ed[0, WRIST] = 1.0
    refused = runtime.arm(np.ones(1, dtype=bool))
    assert explain_reasons(runtime, int(refused[0])) == "a joint moves while the drives are off (wrist_2)"


def test_refused_arming_names_the_current_reasons():
    """Not what did in the last tick: nobody asks a robot without power whether it may go on."""
    runtime = built(1)
    heard(runtime)
    beyond(runtime)
    refused = runtime.arm(np.ones(1, dtype=bool))
    said = explain_reasons(runtime, int(refused[0]))
    assert f"{REASONS[Reason.OUTSIDE].text} (wrist_2)" in said
    assert said.endswith(f"{REASONS[Reason.MOVING].text} (wrist_2)")  # it is far from where it rested
