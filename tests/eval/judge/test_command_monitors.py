"""Monitors of the command: differences of what was sent, first ticks of power, jerk-limited trajectories."""

import numpy as np
import pytest
import ruckig

pytest.importorskip("mujoco")

from support.arm6 import SPEC
from support.eval.judges import (
    DT,
    HOME,
    LIMITS,
    Q_MAX,
    Q_MIN,
    RATE,
    Bench,
    N,
    hold,
)


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(
    ("name", "field", "order"),
    [("velocity_sent", "qd_max", 1), ("acceleration", "qdd_max", 2), ("jerk", "qddd_max", 3)],
)
@pytest.mark.parametrize(("share", "fires"), [(1 + 2e-4, True), (1 - 2e-4, False), (-1 - 2e-4, True)])
def test_derivatives_of_the_sent_command(name, field, order, share, fires, joint):
    """A trajectory of constant derivative, seen from the tick on which power came."""
    bench = Bench()
    rate = share * getattr(SPEC.joints[joint], field)
    for tick in range(4):
        ladder = np.prod([tick - k for k in range(order)]) / [1, 2, 6][order - 1]
        hold(bench, joint, HOME[joint] + rate * ladder * DT**order)
        bench.step()
    from_rest = {"command_jump"} if order == 1 else set()
    assert bench.fired() == ({name} if fires else set()) | from_rest
    counts = bench.judge.counts()
    assert counts.bad_ticks[:, counts.columns(name)].sum() == (4 - order if fires else 0)


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(
    ("name", "field", "order"),
    [("velocity_sent", "qd_max", 1), ("acceleration", "qdd_max", 2), ("jerk", "qddd_max", 3)],
)
@pytest.mark.parametrize(("share", "fires"), [(1 + 2e-4, True), (1 - 2e-4, False), (-1 - 2e-4, True)])
def test_derivatives_of_the_speeds_sent_to_a_wheel(name, field, order, share, fires, joint):
    """A drive without stiffness follows speeds: the angles sent, which jump here, do not count."""
    bench = Bench()
    bench.drive.kp[0, joint] = 0.0
    rate = share * getattr(SPEC.joints[joint], field)
    for tick in range(1, 5):
        way = [np.prod([t - k for k in range(order)]) / [1, 2, 6][order - 1] for t in (tick - 1, tick)]
        bench.speed_sent[0, joint] = rate * (way[1] - way[0]) * DT ** (order - 1)
        bench.truth.q[0, joint] = bench.sent[0, joint] = HOME[joint] + 0.001 * (tick % 2)
        bench.step()
    assert bench.fired() == ({name} if fires else set())


def test_a_drive_without_stiffness_and_damping_follows_no_speed():
    """In torque mode the speed sent is that of the estimate."""
    bench = Bench()
    bench.drive.kp[:], bench.drive.kd[:] = 0.0, 0.0
    for _ in range(5):
        bench.speed_sent += 1.0
        bench.step()
    assert bench.fired() == set()


@pytest.mark.parametrize("ticks_of_power", [1, 2, 3, 4])
def test_a_difference_needs_power_on_all_its_ticks(ticks_of_power):
    """A jump of the angle where drives were off is no motion; inside powered ticks it is one."""
    bench = Bench()
    bench.powered[:] = False
    bench.sent[:] = HOME + 0.3
    bench.step(3)
    bench.powered[:] = True
    bench.sent[:] = HOME
    bench.step(ticks_of_power)
    assert bench.fired() == set()
    bench.sent[:] = bench.truth.q[:] = HOME + 0.1
    bench.step()
    due = {*["velocity_sent", "acceleration", "jerk"][: min(ticks_of_power, 3)]}
    assert bench.fired() == (due | {"command_jump"} if ticks_of_power == 1 else due)


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(("by", "fires"), [(2e-4, True), (-2e-4, False)])
def test_torque_rate_limit(joint, by, fires):
    bench = Bench()
    for _ in range(3):
        bench.tau_sent[0, joint] -= (1 + by) * RATE[joint] * DT
        bench.step()
    assert bench.fired() == ({"torque_rate"} if fires else set())
    assert bench.judge.counts().bad_ticks.sum() == 2 * fires  # the first tick has none before it


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(("by", "fires"), [(2e-4, True), (-2e-4, False), (np.nan, True)])
def test_power_on_happens_at_the_true_position(joint, by, fires):
    reach = SPEC.joint_array("qdd_max") * DT**2
    bench = Bench(robots=2)
    bench.powered[:] = False
    bench.sent[:] = 7.0
    bench.step(3)
    bench.powered[:] = True
    bench.sent[:] = HOME
    bench.sent[1, joint] -= LIMITS.arming_rad + (1 + by) * reach[joint]
    bench.step()
    bench.sent[1, joint] = np.nan_to_num(bench.sent[1, joint])
    assert bench.fired() - {"tracking"} == ({"command_jump"} if fires else set())


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(("by", "fires"), [(2e-4, True), (-2e-4, False)])
def test_second_powered_tick_starts_from_rest(joint, by, fires):
    bench = Bench()
    bench.powered[:] = False
    bench.step(40)
    bench.powered[:] = True
    bench.step()
    hold(bench, joint, HOME[joint] + (1 + by) * SPEC.joints[joint].qdd_max * DT**2)
    bench.step()
    assert bench.fired() == ({"command_jump"} if fires else set())


@pytest.mark.parametrize("seed", [0, 1])
def test_jerk_limited_trajectories_at_the_limits_never_fire(seed):
    """Ruckig at exactly the limits, with new targets at random times: its loads touch 1 and never pass it."""
    rng = np.random.default_rng(seed)
    bench, otg = Bench(), ruckig.Ruckig(N, DT)
    inp, out = ruckig.InputParameter(N), ruckig.OutputParameter(N)
    inp.synchronization = ruckig.Synchronization.No
    inp.current_position = HOME
    inp.max_velocity, inp.max_acceleration = SPEC.joint_array("qd_max"), SPEC.joint_array("qdd_max")
    inp.max_jerk = SPEC.joint_array("qddd_max")
    for tick in range(4000):
        if tick % 100 == 0:
            inp.target_position = rng.uniform(Q_MIN + 0.05, Q_MAX - 0.05)
        assert otg.update(inp, out) >= 0
        bench.sent[:] = bench.truth.q[:] = out.new_position
        bench.step()
        out.pass_to_input(inp)
    counts = bench.judge.counts()
    assert bench.fired() <= {"position_soft", "position_hard", "singularity"}
    for name in ("velocity_sent", "acceleration", "jerk"):
        assert 0.99 < counts.worst[:, counts.columns(name)].max() <= 1


def free(bench):
    """Drives that follow no angle."""
    bench.drive = bench.drive._replace(kp=np.zeros_like(bench.drive.kp))


def test_angles_sent_to_drives_that_follow_none_are_no_command():
    bench = Bench()
    free(bench)
    for shift in (0.3, -0.2, 0.5):
        bench.sent[:] = HOME + shift
        bench.step()
    assert bench.fired() == {"tracking"}


@pytest.mark.parametrize(
    ("share", "off", "fires"), [(1.0, 0.002, False), (1.0, 0.02, True), (0.01, 0.02, False)]
)
def test_drives_that_take_over_a_moving_joint_begin_where_its_speed_brought_it(share, off, fires):
    bench = Bench()
    own = bench.drive
    free(bench)
    bench.truth.qd[:] = 1.0
    for _ in range(3):
        bench.truth.q[:] += DT
        bench.sent[:] = bench.truth.q
        bench.step()
    bench.drive = own._replace(kp=own.kp * share)
    bench.truth.q[:] += DT
    bench.sent[:] = bench.truth.q + off
    bench.step()
    assert bench.fired() == ({"command_jump"} if fires else set())


@pytest.mark.parametrize(
    ("share", "off", "fires"),
    [(0.5, 0.045, True), (0.5, 0.035, False), (1.0, 0.03, True), (0.01, 0.3, False)],
)
def test_the_angle_of_a_takeover_counts_by_the_stiffness_that_drives_have_reached(share, off, fires):
    bench = Bench()
    own = bench.drive
    free(bench)
    bench.step(3)
    for part in (0.001, share):
        bench.drive = own._replace(kp=own.kp * part)
        bench.sent[:] = HOME + off
        bench.step()
    assert ("command_jump" in bench.fired()) == fires


def test_a_takeover_at_a_wrong_angle_is_seen_although_it_begins_soft():
    bench = Bench()
    own = bench.drive
    free(bench)
    bench.step(3)
    bench.sent[:] = HOME + 0.3
    for tick in range(20):
        bench.drive = own._replace(kp=own.kp * 0.01 ** (1 - tick / 20))
        bench.step()
    assert "command_jump" in bench.fired()


def test_drives_that_are_always_softer_than_their_own_gains_take_nothing_over():
    bench = Bench()
    bench.drive = bench.drive._replace(kp=0.5 * bench.drive.kp)
    bench.step(3)
    bench.sent[:] = HOME + 0.08
    bench.step(3)
    assert "command_jump" not in bench.fired()
