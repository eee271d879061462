"""What becomes of a robot whose windings are hot: slower, weaker, and stopped before any of them is lost."""

import numpy as np
import pytest

from deploy.estimation.foldback import STEPS
from deploy.motion.smoother import Smoother
from deploy.reasons import Reason
from deploy.state import Mode
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm
from support.contracts import arm_contract
from support.deploy.thermal import HARD, PACE_MIN, SOFT, THERMAL
from support.runtimes import Saying, heard

N, DT = SPEC.n, SPEC.dt


def test_step_in_pace_during_braking_keeps_the_range():
    """From full speed towards the end of the working range, at any moment of the braking."""
    room = SPEC.margins.q_target_rad - SPEC.margins.q_soft_rad
    home, still = SPEC.joint_array("q_home")[None], np.zeros(40, dtype=bool)
    smoother, far = Smoother(SPEC, 40), np.repeat(home + 1.2, 40, axis=0)
    smoother.hold(np.ones(40, dtype=bool), np.repeat(home, 40, axis=0))
    beyond = 0.0
    target = np.minimum(far, SPEC.joint_array("q_max") - SPEC.margins.q_target_rad)
    for tick in range(400):
        smoother.speed_share[tick >= 40 + 3 * np.arange(40)] = 1.0 - (1.0 - PACE_MIN) / STEPS
        smoother.commit(smoother.next(far, still))
        beyond = max(beyond, (smoother.q - target).max())
    assert 0.0 < beyond < room
    np.testing.assert_allclose(smoother.q, target, atol=1e-6)


def test_reduced_pace_is_respected_and_stops_use_full_limits():
    """Differences of what was sent, at half the pace; the stop in between is as quick as ever."""
    smoother, whole = Smoother(SPEC, 2), Smoother(SPEC, 2)
    home = np.tile(SPEC.joint_array("q_home"), (2, 1))
    for one in (smoother, whole):
        one.hold(np.ones(2, dtype=bool), home)
    smoother.speed_share[1] = 0.5
    far = home + np.array([1.0, -0.6, 0.8, 1.2, -0.8, 2.0])
    sent = [smoother.q.copy()]
    for tick in range(300):
        stopping = np.full(2, 60 <= tick < 130)
        for one in (smoother, whole):
            one.commit(one.next(far, stopping))
        sent.append(smoother.q.copy())
    speed = np.diff(sent, axis=0) / DT
    gain = np.diff(speed, axis=0) / DT
    limit = SPEC.margins.speed * SPEC.joint_array("qd_max"), SPEC.joint_array("qdd_max")
    asked = np.r_[0:59, 131:298]
    for value, most in zip((speed, gain), limit, strict=True):
        peak = np.abs(value[asked, 1]).max(axis=0)
        assert (peak <= 0.5 * most * (1 + 1e-5)).all()
        assert (peak > 0.45 * most).any()
    assert (np.abs(gain[60:130, 1]).max(axis=0) > 0.7 * limit[1]).any()
    np.testing.assert_array_equal(smoother.q[0], whole.q[0])


def hot_arm(tmp_path, **limits):
    """An arm whose shoulder and elbow cannot carry their own weight for long: half a minute."""
    changes = [(f"{name} = [0-9.]+", f"{name} = {value}") for name, value in limits.items()]
    return load_robot(
        copy_of_arm(tmp_path, xml=[(THERMAL[0], 'thermal="28 0.36 0 0.0039 25 25"')], toml=changes)
    )


def lived(spec, seconds, enough_c=np.inf):
    """(T,) °C, the hottest winding in truth, and the runtime, at home while under power and below `enough_c`."""
    simulation = pytest.importorskip("deploy.simulation")
    seeds, hottest = [robot_seed(3, 0)], []
    runtime, robot = simulation.simulate(spec, arm_contract(), seeds, Saying(1))
    heard(runtime)
    assert runtime.arm(np.ones(1, dtype=bool))[0] == 0
    for _ in range(round(seconds / spec.dt)):
        runtime.tick()
        if not runtime.supervisor.powered[0]:
            break
        hottest.append(robot.truth().winding_c.max())
        if hottest[-1] > enough_c:
            break
    return np.array(hottest), runtime


@pytest.mark.slow
def test_foldback_keeps_windings_below_their_hard_limit(tmp_path):
    """It passes it without: the same arm, whose robot.toml says that its windings stand 300 °C."""
    unguarded, _ = lived(
        hot_arm(tmp_path / "off", winding_max_c=300.0, winding_soft_c=250.0), 40.0, HARD[0] + 10
    )
    assert unguarded.max() > HARD[0] + 10
    hottest, runtime = lived(hot_arm(tmp_path / "on"), 40.0)
    assert SOFT[0] < hottest.max() < HARD[0]
    assert runtime.supervisor.mode[0] == Mode.LATCHED
    assert Reason(int(runtime.supervisor.reason[0])) == Reason.HEAT
    assert runtime.estimator.windings.foldback.speed_share[0] == PACE_MIN
    np.testing.assert_allclose(runtime.state.winding_c.max(), hottest[-1], atol=8)


def test_stopping_robot_has_its_full_current(tmp_path):
    """The stop was checked with it; a robot at work keeps to its share."""
    spec = hot_arm(tmp_path)
    simulation = pytest.importorskip("deploy.simulation")
    seeds = [robot_seed(3, robot) for robot in range(2)]
    runtime, _ = simulation.simulate(spec, arm_contract(), seeds, Saying(2))
    heard(runtime)
    runtime.arm(np.ones(2, dtype=bool))
    for _ in range(103):
        runtime.tick()
    runtime.estimator.windings.foldback.current_share[:] = 0.7
    runtime.requested_stop[1] = int(Reason.OPERATOR)
    runtime.tick()
    assert runtime.supervisor.mode.tolist() == [Mode.RUNNING, Mode.STOPPING]
    np.testing.assert_array_equal(runtime.command.current_share, np.repeat([[0.7], [1.0]], N, axis=1))
