"""The judge against a slow reference and its own resumption; counts of time, stops and goals."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from deploy.reasons import Reason

pytest.importorskip("mujoco")

from deploy.state import Mode
from deploy.tasks.reach import Reach
from deploy.tasks.velocity import Velocity
from eval.judge.counts import REASON_NAMES, Counts, merge
from eval.judge.judge import Judge
from eval.judge.monitors import MONITORS
from robots.errors import ConfigError
from support.arm6 import SPEC, arm_judge
from support.eval.judges import (
    DT,
    GAP,
    LIMITS,
    OBSERVED,
    POWER,
    Q_MAX,
    Q_MIN,
    RATE,
    TORQUE_MAX,
    Bench,
    N,
    feed,
    random_series,
)
from support.quadruped import QUADRUPED

PER_JOINT = [monitor for monitor in MONITORS if monitor.per_joint]


def test_clean_motion_counts_nothing():
    bench = Bench(robots=3)
    bench.step(ticks=GAP)
    counts = bench.judge.counts()
    assert bench.fired() == set()
    assert counts.evaluations == 3 * GAP
    assert counts.worst.max() < 1
    assert counts.bad_draws() == 0


def test_every_input_is_written_on_every_tick():
    bench = Bench(robots=2)
    bench.step()
    judge, written = bench.judge, {}
    for sentinel in (0, 1):  # twice: a flag has no third value
        for array in judge.buffer.ticks:
            array[judge.buffer.row] = sentinel
        row = judge.buffer.row
        bench.step()
        for name, array in judge.buffer.ticks._asdict().items():
            written[name] = written.get(name, False) or bool((array[row] != sentinel).any())
    assert all(written.values()), [name for name in written if not written[name]]


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
        "position_soft": abs(m.at("q") - middle) / (half - SPEC.margins.q_soft_rad),
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
    assert all(counts.total(each.name) for each in PER_JOINT if each in counts.monitors)


def test_stops_and_goals_equal_a_slow_reference():
    ticks, robots = 2000, 2
    series = random_series(ticks, robots, seed=4)
    judge = arm_judge(TORQUE_MAX, robots, observed=OBSERVED)
    feed(judge, series, range(ticks))
    stops, latches, reached, reasons = *np.zeros((3, robots)), np.zeros((robots, len(REASON_NAMES)))
    before = [Mode.DISARMED] * robots
    for t, r in np.ndindex(ticks, robots):
        mode, reason = series["mode"][t, r], Reason(int(series["reason"][t, r]))
        cut = (before[r], mode) == (Mode.ARMING, Mode.LATCHED)
        if mode != before[r] and (mode == Mode.STOPPING or before[r] == Mode.RUNNING or cut):
            stops[r] += 1
            for k, name in enumerate(REASON_NAMES):
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


def test_intermediate_queries_change_nothing():
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


def test_skipped_goal_counts_as_missed():
    bench = Bench()
    bench.step(round(5.5 * Reach.success_criterion(SPEC).period_s / DT))
    assert bench.judge.counts().goals_due == 4
    bench.attempted[:] = 5
    bench.step()
    counts = bench.judge.counts()
    assert (counts.goals_due, counts.reached.tolist()) == (5, [1])


def walk(task, bench, share, factor=1.0):
    """Walk for a share of the command's period, at the commanded velocity times a factor."""
    for _ in range(round(share * task.criterion.period_s / DT)):
        bench.truth.tool_position[:] = task.achieved[:] = factor * task.goal
        task.step(bench.mode == Mode.RUNNING)
        bench.goal, bench.goal_number, bench.attempted = task.goal, task.number, task.attempted
        bench.step()


@pytest.mark.parametrize(("factor", "reached"), [(1.0, 1), (0.0, 0)])
def test_a_mean_counts_only_what_was_achieved_for_the_goal_that_is_over(factor, reached):
    """Arming replaces a command before its end: what was achieved for it counts for no other."""
    task, bench = Velocity(QUADRUPED, [np.random.SeedSequence(1)]), Bench()
    bench.judge = Judge(SPEC, TORQUE_MAX, 1, criterion=task.criterion, observed=OBSERVED)
    walk(task, bench, 0.9)
    task.arm(np.ones(1, dtype=bool))
    walk(task, bench, 1.0, factor)
    counts = bench.judge.counts()
    assert task.reached.tolist() == counts.reached.tolist() == [reached]
    assert counts.attempted.tolist() == [1]
    walk(task, bench, 1.0)
    assert bench.judge.counts().reached.tolist() == [reached + 1]
