"""The judge against limit attacks, a slow reference, jerk-limited trajectories and its own resumption."""

from dataclasses import dataclass, fields

import numpy as np
import pytest
import ruckig

pytest.importorskip("mujoco")

from deploy.state import Mode, Reason
from deploy.tasks.reach import Reach
from eval.judge.counts import REASONS, Counts, merge
from eval.judge.monitors import MONITORS
from robots.errors import ConfigError
from robots.models.fleet import Fleet
from support.arm6 import SPEC, arm_judge
from support.eval.judges import (
    CENTRE,
    DT,
    GAP,
    HOME,
    LIMITS,
    OBSERVED,
    POWER,
    Q_MAX,
    Q_MIN,
    RATE,
    SIZE,
    SPACE,
    TORQUE_MAX,
    Bench,
    N,
    feed,
    random_series,
)

PER_JOINT = [monitor for monitor in MONITORS if monitor.per_joint]


def test_nothing_wrong_nothing_counted():
    bench = Bench(robots=3)
    bench.step(ticks=GAP)
    counts = bench.judge.counts()
    assert bench.fired() == set()
    assert counts.evaluations == 3 * GAP
    assert counts.worst.max() < 1
    assert counts.bad_draws() == 0


HAIR = 1e-6
SOFT = SPEC.margins.q_soft_rad
ALONG = {"heat_hard": {"heat_soft"}, "position_hard": {"position_soft"}}


def hold(bench, joint, q):
    bench.truth.q[0, joint] = bench.sent[0, joint] = q


def work(bench, joint, power):
    """So fast that a little torque is much power, whose sign does not matter."""
    bench.truth.qd[0, joint], bench.truth.tau[0, joint] = -2.0, power / 2.0


ATTACKS = {
    "position_requested": lambda b, j, by: b.target.q[0].__setitem__(j, Q_MAX[j] + by),
    "position_soft": lambda b, j, by: hold(b, j, Q_MAX[j] - SOFT + by),
    "position_hard": lambda b, j, by: hold(b, j, Q_MIN[j] - by),
    "velocity": lambda b, j, by: b.truth.qd[0].__setitem__(j, -SPEC.joints[j].qd_max - by),
    "torque": lambda b, j, by: b.truth.tau[0].__setitem__(j, -0.999 * TORQUE_MAX[j] - by),
    "power": lambda b, j, by: work(b, j, POWER[j] + by),
    "estimate": lambda b, j, by: b.off[0].__setitem__(j, -1e-3 * np.sqrt(LIMITS.nees + by)),
    "heat_soft": lambda b, j, by: b.truth.winding_c[0].__setitem__(
        j, SPEC.motor_array("winding_soft_c")[j] + by
    ),
    "heat_hard": lambda b, j, by: b.truth.winding_c[0].__setitem__(
        j, SPEC.motor_array("winding_max_c")[j] + by
    ),
    "tracking": lambda b, j, by: b.truth.q[0].__setitem__(j, HOME[j] + SPEC.margins.tracking_rad + by),
}


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("name", ATTACKS)
def test_a_hair_over_a_joint_limit_fires_and_a_hair_under_does_not(name, joint):
    over, under = Bench(robots=2), Bench(robots=2)
    ATTACKS[name](over, joint, HAIR)
    ATTACKS[name](under, joint, -HAIR)
    over.step(5)
    under.step(5)
    assert over.fired() == {name} | ALONG.get(name, set())
    assert name not in under.fired()
    assert (
        over.judge.counts().events[0, over.judge.counts().columns(name)].tolist() == np.eye(N)[joint].tolist()
    )
    assert not over.judge.counts().events[1].any()


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(
    ("name", "field", "order"),
    [("velocity_sent", "qd_max", 1), ("acceleration", "qdd_max", 2), ("jerk", "qddd_max", 3)],
)
@pytest.mark.parametrize(("share", "fires"), [(1 + 2e-4, True), (1 - 2e-4, False), (-1 - 2e-4, True)])
def test_differences_of_what_was_sent(name, field, order, share, fires, joint):
    """A trajectory of constant derivative, seen from the tick on which power came."""
    bench = Bench()
    rate = share * getattr(SPEC.joints[joint], field)
    for tick in range(8):
        ladder = np.prod([tick - k for k in range(order)]) / [1, 2, 6][order - 1]
        hold(bench, joint, HOME[joint] + rate * ladder * DT**order)
        bench.step()
    from_rest = {"command_jump"} if order == 1 else set()
    assert bench.fired() == ({name} if fires else set()) | from_rest
    counts = bench.judge.counts()
    assert counts.bad_ticks[:, counts.columns(name)].sum() == (8 - order if fires else 0)


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


def test_without_power_tracking_is_no_matter():
    bench = Bench()
    bench.powered[:] = False
    bench.sent[:] = np.nan
    bench.step(5)
    assert bench.fired() == set()


@pytest.mark.parametrize(("by", "fires"), [(HAIR, True), (-HAIR, False)])
@pytest.mark.parametrize(
    ("name", "field", "row"),
    [
        ("workspace", "tool_position", lambda by: CENTRE - np.array([0.0, SPACE.radius_max + by, 0.0])),
        ("workspace", "tool_position", lambda by: [0.3, 0.1, SPACE.z_min - by]),
        ("tool_speed", "tool_velocity", lambda by: [0.0, 0.0, -SPACE.tool_speed_max - by]),
        ("contact_force", "contact_n", lambda by: LIMITS.contact_n + by),
    ],
)
def test_tool_limits(name, field, row, by, fires):
    bench = Bench(robots=2)
    getattr(bench.truth, field)[1] = row(by)
    bench.step()
    assert bench.fired() == ({name} if fires else set())
    assert bench.judge.counts().bad_draws(name) == int(fires)


def beside_singularity(w):
    """Home with its wrist bent so far that det J, as Pinocchio computes it, is `w`."""
    fleet, low, high = Fleet(SPEC, 1), HOME.copy(), HOME.copy()
    high[4] *= -1
    while abs(low[4] - high[4]) > 1e-12:
        middle = (low + high) / 2
        kinematics = fleet.kinematics(middle[None])
        low, high = (middle, high) if kinematics.manipulability()[0] > w else (low, middle)
    return low


@pytest.mark.parametrize(
    ("share", "load"), [(1 - HAIR, 1 + HAIR), (1 + HAIR, 1 - HAIR), (4.0, 0.25), (1e-4, 1e3), (-300, 1e3)]
)
def test_a_singularity_is_near_on_this_side_and_anything_on_the_other(share, load):
    bench = Bench(robots=3)
    bench.truth.q[1] = bench.sent[1] = beside_singularity(share * LIMITS.manipulability)
    bench.step()
    counts = bench.judge.counts()
    columns = counts.columns("singularity")
    assert bench.fired() - {"position_soft", "position_hard"} == ({"singularity"} if load > 1 else set())
    assert counts.worst[1, columns] == pytest.approx(load, rel=1e-8)
    assert counts.limits[columns] == pytest.approx(1 / LIMITS.manipulability)
    assert (counts.worst[::2, columns] < 0.01).all()  # at home


@pytest.mark.parametrize("what", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("mode", "then", "powered", "fires"),
    [
        (Mode.RUNNING, Mode.RUNNING, True, True),
        (Mode.ARMING, Mode.RUNNING, True, True),
        (Mode.RUNNING, Mode.STOPPING, True, False),
        (Mode.STOPPING, Mode.STOPPING, True, False),
        (Mode.DISARMED, Mode.RUNNING, False, False),
    ],
)
def test_who_hears_what_is_no_number_stops_by_the_next_tick(what, mode, then, powered, fires):
    bench = Bench(robots=2)
    bench.action[1, 3] = what
    bench.mode[:], bench.powered[:] = mode, powered
    bench.step()
    assert bench.fired() == set()
    bench.action, bench.mode[:], bench.powered[:] = None, then, True
    bench.step(3)
    counts = bench.judge.counts()
    assert bench.fired() == ({"action_finite"} if fires else set())
    assert counts.bad_ticks[:, counts.columns("action_finite")].ravel().tolist() == [0, int(fires)]


def test_self_collision():
    bench = Bench(robots=2)
    bench.truth.self_collision[0] = True
    bench.step()
    assert bench.fired() == {"self_collision"}


@pytest.mark.parametrize("name", [*ATTACKS, "workspace", "tool_speed"])
def test_nan_is_bad(name):
    bench = Bench()
    if name in ATTACKS:
        ATTACKS[name](bench, 2, np.nan)
    else:
        bench.truth.tool_position[:] = bench.truth.tool_velocity[:] = np.nan
    bench.step(3)
    assert name in bench.fired()
    counts = bench.judge.counts()
    assert np.isinf(counts.worst[:, counts.columns(name)].max())
    assert not np.isnan(counts.worst).any()


def test_diverged_robots_are_counted_and_not_judged():
    bench = Bench(robots=2)
    bench.step(4)
    bench.truth.valid[1] = False
    for array in (bench.truth.q, bench.truth.qd, bench.truth.tool_position):
        array[1] = np.nan
    bench.truth.tool_velocity[1] = 1e300
    bench.step(6)
    counts = bench.judge.counts()
    assert bench.fired() == set()
    assert counts.invalid.tolist() == [0, 6]
    assert counts.evaluations == 10 + 4
    assert counts.availability == 14 / 20


@pytest.mark.parametrize(("pause", "events"), [(1, 1), (GAP - 1, 1), (GAP, 2), (3 * GAP, 2)])
def test_events_merge_over_less_than_the_gap(pause, events):
    bench = Bench()
    for ticks, load in [(3, 3.0), (pause, 0.0), (2, 2.0), (GAP, 0.0)]:
        bench.truth.qd[0, 1] = load * SPEC.joint_array("qd_max")[1]
        bench.step(ticks)
    counts = bench.judge.counts()
    logged = [(e.start, e.ticks, round(e.worst, 9), e.monitor.name, e.joint) for e in counts.log()]
    first = (0, 5 + pause if events == 1 else 3, 3.0, "velocity", "shoulder_lift")
    second = (3 + pause, 2, 2.0, "velocity", "shoulder_lift")
    assert logged == [first, second][:events]
    assert counts.total("velocity") == events
    assert counts.bad_ticks.sum() == 5


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(("by", "fires"), [(2e-4, True), (-2e-4, False)])
def test_torque_sent_may_not_change_too_fast(joint, by, fires):
    bench = Bench()
    for _ in range(3):
        bench.tau_sent[0, joint] -= (1 + by) * RATE[joint] * DT
        bench.step()
    assert bench.fired() == ({"torque_rate"} if fires else set())
    assert bench.judge.counts().bad_ticks.sum() == 2 * fires  # the first tick has none before it


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize(("by", "fires"), [(2e-4, True), (-2e-4, False), (np.nan, True)])
def test_power_comes_where_the_joint_truly_stands(joint, by, fires):
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
def test_the_second_tick_of_power_begins_from_rest(joint, by, fires):
    bench = Bench()
    bench.powered[:] = False
    bench.step(40)
    bench.powered[:] = True
    bench.step()
    hold(bench, joint, HOME[joint] + (1 + by) * SPEC.joints[joint].qdd_max * DT**2)
    bench.step()
    assert bench.fired() == ({"command_jump"} if fires else set())


@pytest.mark.parametrize(("by", "fires"), [(HAIR, True), (-HAIR, False)])
def test_power_of_the_whole_robot_is_the_sum_of_its_joints(by, fires):
    bench = Bench()
    bench.truth.qd[:], bench.truth.tau[:] = 1.0, [100.0, 150.0, 80.0, 20.0, 0.0, LIMITS.power_w - 350.0 + by]
    bench.truth.tau[0, 5] -= 0.0
    bench.step()
    assert ("robot_power" in bench.fired()) == fires
    bench.truth.qd[0, 1] = -1.0
    before = bench.judge.counts().bad_ticks[:, bench.judge.counts().columns("robot_power")].sum()
    bench.step()
    counts = bench.judge.counts()
    assert counts.bad_ticks[:, counts.columns("robot_power")].sum() == before


@pytest.mark.parametrize("which", range(SIZE))
@pytest.mark.parametrize(("by", "fires"), [(1e-3, True), (-1e-3, False), (np.nan, True)])
def test_an_observation_that_training_never_saw(which, by, fires):
    bench = Bench(robots=2)
    bench.observation[1, which] += 0.5 * (LIMITS.deviations + by)
    bench.step()
    assert bench.fired() == ({"observation"} if fires else set())
    bench.mode[:] = Mode.HOLDING
    bench.step()
    counts = bench.judge.counts()
    assert counts.bad_ticks.sum() == int(fires)
    assert counts.limits[counts.columns("observation")].tolist() == [LIMITS.deviations]


def test_without_a_memory_of_training_observations_are_not_judged():
    bench = Bench()
    bench.judge = arm_judge(TORQUE_MAX, 1)
    bench.observation[:] = 1e9
    bench.step(3)
    counts = bench.judge.counts()
    assert bench.fired() == set()
    assert np.isinf(counts.limits[counts.columns("observation")])
    assert counts.worst[:, counts.columns("observation")].max() == 0.0


@pytest.mark.parametrize("field", ["age", "valid"])
def test_a_belief_that_does_not_claim_to_be_one_is_not_judged(field):
    bench = Bench()
    bench.off[:] = 1.0
    if field == "age":
        bench.age[:] = np.inf
        bench.q_var[:] = 0.0
        bench.step(3)
        assert bench.fired() == set()
    else:
        bench.truth.valid[:] = False
        bench.step()
        bench.truth.valid[:] = True
        bench.step()
        assert bench.fired() == set()
        bench.step()
        assert bench.fired() == {"estimate"}


@dataclass(frozen=True)
class Moment:
    """One tick of one robot's joint in a series, and those before it."""

    series: dict
    robot: int
    joint: int
    t: int

    def at(self, name, back=0):
        return float(self.series[name][self.t - back, self.robot, self.joint])

    def valid(self, back):
        return self.t >= back and bool(self.series["valid"][self.t - back, self.robot])

    def on(self, *backs):
        return all(self.valid(back) and self.series["powered"][self.t - back, self.robot] for back in backs)


def true_loads(m):
    """Each joint monitor's load of what is true, straight from its definition."""
    middle, half = (Q_MIN[m.joint] + Q_MAX[m.joint]) / 2, (Q_MAX[m.joint] - Q_MIN[m.joint]) / 2
    motor = SPEC.motors[SPEC.joints[m.joint].motor]
    loads = {
        "position_requested": abs(m.at("target") - middle) / half if m.on(0) else 0.0,
        "position_soft": abs(m.at("q") - middle) / (half - SOFT),
        "position_hard": abs(m.at("q") - middle) / half,
        "velocity": abs(m.at("qd")) / SPEC.joints[m.joint].qd_max,
        "torque": abs(m.at("tau")) / (0.999 * TORQUE_MAX[m.joint]),
        "power": abs(m.at("tau") * m.at("qd")) / POWER[m.joint],
        "heat_soft": m.at("winding_c") / motor.winding_soft_c,
        "heat_hard": m.at("winding_c") / motor.winding_max_c,
        "tracking": abs(m.at("q") - m.at("sent")) / SPEC.margins.tracking_rad if m.on(0) else 0.0,
        "estimate": 0.0,
    }
    if m.valid(1) and np.isfinite(m.series["age"][m.t, m.robot]):
        error = np.nan_to_num(m.at("q")) + m.at("off") - m.at("q", 1)
        loads["estimate"] = error**2 / m.at("q_var") / LIMITS.nees
    return loads


def sent_loads(m):
    """The same of what was sent."""
    spec, slack = SPEC.joints[m.joint], 1 + 1e-4
    loads = {"torque_rate": 0.0}
    if m.on(0, 1):
        loads["torque_rate"] = abs(m.at("tau_sent") - m.at("tau_sent", 1)) / DT / RATE[m.joint] / slack
    jump = 0.0
    if m.on(0) and m.valid(1) and not m.on(1):
        jump = np.maximum(abs(m.at("sent") - m.at("q", 1)) - LIMITS.arming_rad, 0.0)
    elif m.on(0, 1) and not m.on(2):
        jump = abs(m.at("sent") - m.at("sent", 1))
    loads["command_jump"] = jump / (spec.qdd_max * DT**2) / slack
    stencils = {"velocity_sent": [1, -1], "acceleration": [1, -2, 1], "jerk": [1, -3, 3, -1]}
    for order, (name, stencil) in enumerate(stencils.items(), start=1):
        limit = (spec.qd_max, spec.qdd_max, spec.qddd_max)[order - 1] * slack
        difference = (
            sum(c * m.at("sent", k) for k, c in enumerate(stencil)) if m.on(*range(order + 1)) else 0.0
        )
        loads[name] = abs(difference) / DT**order / limit
    return loads


def reference(series, robot, joint, ticks):
    """Bad ticks, events and worst load of each joint monitor, one tick after another."""
    found = {monitor.name: [0, 0, 0.0] for monitor in PER_JOINT}
    last = {}
    for t in range(ticks):
        if not series["valid"][t, robot]:
            continue
        moment = Moment(series, robot, joint, t)
        for name, number in (true_loads(moment) | sent_loads(moment)).items():
            load = np.inf if np.isnan(number) else number
            found[name][2] = max(found[name][2], load)
            if load > 1:
                found[name][0] += 1
                found[name][1] += name not in last or t - last[name] > GAP
                last[name] = t
    return found


def test_counts_equal_a_slow_reference():
    ticks, robots = 600, 3
    series = random_series(ticks, robots, seed=3)
    judge = arm_judge(TORQUE_MAX, robots, observed=OBSERVED)
    feed(judge, series, range(ticks))
    counts = judge.counts()
    for robot in range(robots):
        for joint in range(N):
            for name, (bad_ticks, events, worst) in reference(series, robot, joint, ticks).items():
                channel = counts.columns(name).start + joint
                assert (counts.bad_ticks[robot, channel], counts.events[robot, channel]) == (
                    bad_ticks,
                    events,
                )
                assert counts.worst[robot, channel] == pytest.approx(worst, rel=1e-6, abs=1e-6)
    assert all(counts.total(monitor.name) for monitor in PER_JOINT)


def test_stops_and_goals_equal_a_slow_reference():
    ticks, robots = 2000, 2
    series = random_series(ticks, robots, seed=4)
    judge = arm_judge(TORQUE_MAX, robots, observed=OBSERVED)
    feed(judge, series, range(ticks))
    stops, latches, reached, reasons = *np.zeros((3, robots)), np.zeros((robots, len(REASONS)))
    before = [Mode.DISARMED] * robots
    for t, r in np.ndindex(ticks, robots):
        mode, reason = series["mode"][t, r], Reason(int(series["reason"][t, r]))
        if mode != before[r] and (mode == Mode.STOPPING or before[r] == Mode.RUNNING):
            stops[r] += 1
            for k, name in enumerate(REASONS):
                reasons[r, k] += reason == Reason.NONE if k == 0 else Reason[name] in reason
        latches[r] += mode == Mode.LATCHED != before[r]
        before[r] = mode
        if t and series["attempted"][t, r] > series["attempted"][t - 1, r]:
            missed = np.linalg.norm(series["tool_position"][t, r] - series["goal"][t - 1, r])
            reached[r] += missed <= 0.02 and mode == Mode.RUNNING and series["valid"][t, r]
    counts = judge.counts()
    assert (counts.stops.tolist(), counts.latches.tolist()) == (stops.tolist(), latches.tolist())
    assert (counts.latches > 10).all()
    assert counts.reasons.tolist() == reasons.tolist()
    assert counts.reached.tolist() == reached.tolist()
    assert (counts.reached > 10).all()
    assert counts.attempted.tolist() == series["attempted"][-1].tolist()


def test_resumed_and_split_runs_give_the_same_counts():
    ticks = 300
    series = random_series(ticks, 4, seed=5)
    whole, first, second = (arm_judge(TORQUE_MAX, 4, observed=OBSERVED) for _ in range(3))
    feed(whole, series, range(ticks))
    feed(first, series, range(140))
    second.restore(first.save())
    feed(second, series, range(140, ticks))
    halves = [arm_judge(TORQUE_MAX, 2, observed=OBSERVED) for _ in range(2)]
    for judge, rows in zip(halves, (slice(0, 2), slice(2, 4)), strict=True):
        feed(judge, series, range(ticks), rows)
    merged = merge(halves[0].counts(), halves[1].counts())
    for field in fields(Counts):
        wanted = getattr(whole.counts(), field.name)
        np.testing.assert_array_equal(getattr(second.counts(), field.name), wanted)
        np.testing.assert_array_equal(getattr(merged, field.name), wanted)


def test_asking_in_between_changes_nothing():
    """Ticks wait to be judged together; whoever asks for counts makes the judge look at what waits."""
    ticks = 150
    series = random_series(ticks, 2, seed=6)
    asked, left = arm_judge(TORQUE_MAX, 2), arm_judge(TORQUE_MAX, 2)
    feed(left, series, range(ticks))
    for tick in range(ticks):
        feed(asked, series, [tick])
        assert asked.counts().ticks.tolist() == [tick + 1] * 2
    for field in fields(Counts):
        np.testing.assert_array_equal(
            getattr(asked.counts(), field.name), getattr(left.counts(), field.name), strict=True
        )


def test_counts_by_other_limits_do_not_merge():
    other = arm_judge(2 * TORQUE_MAX, 1).counts()
    with pytest.raises(ConfigError, match="limits"):
        merge(arm_judge(TORQUE_MAX, 1).counts(), other)


def test_a_skipped_goal_is_a_goal_missed():
    bench = Bench()
    bench.step(round(5.5 * Reach.scoring(SPEC).period_s / DT))
    assert bench.judge.counts().goals_due == 4
    bench.attempted[:] = 5
    bench.step()
    counts = bench.judge.counts()
    assert (counts.goals_due, counts.reached.tolist()) == (5, [1])


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
