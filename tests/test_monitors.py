"""The judge against limit attacks, a slow reference, jerk-limited trajectories and its own resumption."""

from dataclasses import dataclass, fields

import numpy as np
import pytest
import ruckig

from deploy.state import Command, Mode, Reason, Target
from eval.counts import JOINT_MONITORS, NAMES, REASONS, Counts, merge
from eval.monitors import EVENTS_KEPT, GOAL_S, REARM_S, Judge
from robots.errors import ConfigError
from robots.spec import load_robot

SPEC = load_robot("arm6")
N, DT = SPEC.n, SPEC.dt
TORQUE_MAX = np.array([150.0, 150.0, 150.0, 28.0, 28.0, 28.0])
HOME = SPEC.joint_array("q_home")
Q_MIN, Q_MAX = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
GAP = round(REARM_S / DT)


@dataclass(frozen=True, slots=True)
class World:
    """A truth whose arrays a test may change."""

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    winding_c: np.ndarray
    tool_position: np.ndarray
    tool_velocity: np.ndarray
    self_collision: np.ndarray
    valid: np.ndarray


class Bench:
    """A judge over robots at rest at home, under way, on which nothing is wrong until a test says so."""

    def __init__(self, robots=1):
        self.judge = Judge(SPEC, TORQUE_MAX, robots)
        self.truth = World(
            q=np.tile(HOME, (robots, 1)),
            qd=np.zeros((robots, N)),
            tau=np.zeros((robots, N)),
            winding_c=np.full((robots, N), 25.0),
            tool_position=np.tile([0.4, 0.0, 0.4], (robots, 1)),
            tool_velocity=np.zeros((robots, 3)),
            self_collision=np.zeros(robots, dtype=bool),
            valid=np.ones(robots, dtype=bool),
        )
        self.target = Target(q=np.tile(HOME, (robots, 1)), finite=np.ones(robots, dtype=bool))
        self.sent = np.tile(HOME, (robots, 1))
        self.powered = np.ones(robots, dtype=bool)
        self.mode = np.full(robots, Mode.RUNNING, dtype=np.int8)
        self.reason = np.zeros(robots, dtype=np.int64)
        self.goal = np.tile([0.4, 0.0, 0.4], (robots, 1))
        self.attempted = np.zeros(robots, dtype=np.int64)

    def step(self, ticks=1):
        command = Command(
            q=self.sent, qd=self.sent * 0, tau=self.sent * 0, powered=self.powered, current=self.sent
        )
        for _ in range(ticks):
            self.judge.step(
                truth=self.truth,
                target=self.target,
                command=command,
                mode=self.mode,
                reason=self.reason,
                goal=self.goal,
                attempted=self.attempted,
            )

    def fired(self):
        counts = self.judge.counts()
        return {name for name in NAMES if counts.total(name)}


def test_nothing_wrong_nothing_counted():
    bench = Bench(robots=3)
    bench.step(ticks=GAP)
    counts = bench.judge.counts()
    assert bench.fired() == set()
    assert counts.evaluations == 3 * GAP
    assert counts.worst.max() < 1
    assert counts.bad_draws() == 0


HAIR = 1e-6
CENTRE, SPACE = np.array(SPEC.workspace.centre), SPEC.workspace
SOFT = SPEC.margins.q_soft_rad
ALONG = {"heat_hard": {"heat_soft"}, "position_hard": {"position_soft"}}


def hold(bench, joint, q):
    bench.truth.q[0, joint] = bench.sent[0, joint] = q


ATTACKS = {
    "position_requested": lambda b, j, by: b.target.q[0].__setitem__(j, Q_MAX[j] + by),
    "position_soft": lambda b, j, by: hold(b, j, Q_MAX[j] - SOFT + by),
    "position_hard": lambda b, j, by: hold(b, j, Q_MIN[j] - by),
    "velocity": lambda b, j, by: b.truth.qd[0].__setitem__(j, -SPEC.joints[j].qd_max - by),
    "torque": lambda b, j, by: b.truth.tau[0].__setitem__(j, -0.999 * TORQUE_MAX[j] - by),
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
    assert bench.fired() == ({name} if fires else set())
    counts = bench.judge.counts()
    assert counts.bad_ticks[:, counts.columns(name)].sum() == (8 - order if fires else 0)


@pytest.mark.parametrize("ticks_of_power", [1, 2, 3, 4])
def test_a_difference_needs_power_on_all_its_ticks(ticks_of_power):
    """A jump of the angle where drives were off is no motion; inside powered ticks it is one."""
    bench = Bench()
    bench.powered[:] = False
    bench.sent[:] = bench.truth.q[:] = HOME + 0.3
    bench.step(3)
    bench.powered[:] = True
    bench.sent[:] = bench.truth.q[:] = HOME
    bench.step(ticks_of_power)
    assert bench.fired() == set()
    bench.sent[:] = bench.truth.q[:] = HOME + 0.1
    bench.step()
    due = ["velocity_sent", "acceleration", "jerk"][: min(ticks_of_power, 3)]
    assert bench.fired() == set(due)


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
    ],
)
def test_tool_limits(name, field, row, by, fires):
    bench = Bench(robots=2)
    getattr(bench.truth, field)[1] = row(by)
    bench.step()
    assert bench.fired() == ({name} if fires else set())
    assert bench.judge.counts().bad_draws(name) == int(fires)


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


def test_only_the_first_events_are_logged_and_all_are_counted():
    bench = Bench()
    for _ in range(EVENTS_KEPT + 3):
        bench.truth.self_collision[0] = True
        bench.step()
        bench.truth.self_collision[0] = False
        bench.step(GAP)
    counts = bench.judge.counts()
    assert counts.total("self_collision") == EVENTS_KEPT + 3
    assert [e.start for e in counts.log()] == [k * (GAP + 1) for k in range(EVENTS_KEPT)]
    assert {e.joint for e in counts.log()} == {None}


def random_series(ticks, robots, seed):
    """Everything random around its limit, so that every channel goes in and out; some NaN, some diverged."""
    rng = np.random.default_rng(seed)
    wide = rng.normal(size=(11, ticks, robots, N))
    half = (Q_MAX - Q_MIN) / 2
    middle = (Q_MAX + Q_MIN) / 2
    sent = HOME + np.cumsum(0.006 * wide[5], axis=0)
    series = {
        "q": np.where(wide[6] > 2, sent + 0.1 * wide[7], sent),
        "qd": 2.0 * wide[0],
        "tau": 0.6 * TORQUE_MAX * wide[1],
        "winding_c": 80 + 20 * wide[2],
        "tool_position": CENTRE + 0.4 * rng.normal(size=(ticks, robots, 3)),
        "tool_velocity": 1.2 * rng.normal(size=(ticks, robots, 3)),
        "self_collision": rng.random((ticks, robots)) < 0.02,
        "valid": rng.random((ticks, robots)) > 0.03,
        "target": middle + half * 0.7 * wide[4],
        "sent": sent,
        "powered": rng.random((ticks, robots)) > 0.1,
        "mode": rng.choice([1, 2, 2, 2, 3, 4, 5], size=(ticks, robots)).astype(np.int8),
        "reason": rng.integers(0, 1 << 15, size=(ticks, robots)) * (rng.random((ticks, robots)) > 0.2),
        "goal": CENTRE + 0.4 * rng.normal(size=(ticks, robots, 3)),
        "attempted": np.cumsum(rng.random((ticks, robots)) < 0.05, axis=0),
    }
    series["q"][rng.random(series["q"].shape) < 0.001] = np.nan
    hit = rng.random((ticks, robots)) < 0.5
    series["tool_position"][1:][hit[1:]] = series["goal"][:-1][hit[1:]] + 0.015
    series["tool_position"][1:][hit[1:], :2] -= 0.015
    return series


def feed(judge, series, ticks, rows=slice(None)):
    for t in ticks:
        at = {name: array[t, rows] for name, array in series.items()}
        truth = World(**{field.name: at[field.name] for field in fields(World)})
        judge.step(
            truth=truth,
            target=Target(q=at["target"], finite=at["powered"]),
            command=Command(
                q=at["sent"], qd=at["sent"], tau=at["sent"], powered=at["powered"], current=at["sent"]
            ),
            mode=at["mode"],
            reason=at["reason"],
            goal=at["goal"],
            attempted=at["attempted"],
        )


def reference_loads(series, robot, joint, t):
    """Each joint monitor's load, straight from its definition."""
    joint_spec, motor = SPEC.joints[joint], SPEC.motors[SPEC.joints[joint].motor]

    def at(name, back=0):
        return float(series[name][t - back, robot, joint])

    def whole(count):
        return t + 1 >= count and all(
            series["powered"][t - k, robot] and series["valid"][t - k, robot] for k in range(count)
        )

    middle, half = (Q_MIN[joint] + Q_MAX[joint]) / 2, (Q_MAX[joint] - Q_MIN[joint]) / 2
    loads = {
        "position_requested": abs(at("target") - middle) / half if series["powered"][t, robot] else 0.0,
        "position_soft": abs(at("q") - middle) / (half - SOFT),
        "position_hard": abs(at("q") - middle) / half,
        "velocity": abs(at("qd")) / joint_spec.qd_max,
        "torque": abs(at("tau")) / (0.999 * TORQUE_MAX[joint]),
        "heat_soft": at("winding_c") / motor.winding_soft_c,
        "heat_hard": at("winding_c") / motor.winding_max_c,
    }
    loads["tracking"] = abs(at("q") - at("sent")) / SPEC.margins.tracking_rad if whole(1) else 0.0
    stencils = {"velocity_sent": [1, -1], "acceleration": [1, -2, 1], "jerk": [1, -3, 3, -1]}
    for order, (name, stencil) in enumerate(stencils.items(), start=1):
        limit = (joint_spec.qd_max, joint_spec.qdd_max, joint_spec.qddd_max)[order - 1] * (1 + 1e-4)
        loads[name] = 0.0
        if whole(order + 1):
            loads[name] = abs(sum(c * at("sent", k) for k, c in enumerate(stencil))) / DT**order / limit
    return loads


def reference(series, robot, joint, ticks):
    """Bad ticks, events and worst load of each joint monitor, one tick after another."""
    found = {monitor.name: [0, 0, 0.0] for monitor in JOINT_MONITORS}
    last = {}
    for t in range(ticks):
        if not series["valid"][t, robot]:
            continue
        for name, number in reference_loads(series, robot, joint, t).items():
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
    judge = Judge(SPEC, TORQUE_MAX, robots)
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
    assert all(counts.total(monitor.name) for monitor in JOINT_MONITORS)


def test_stops_and_goals_equal_a_slow_reference():
    ticks, robots = 2000, 2
    series = random_series(ticks, robots, seed=4)
    judge = Judge(SPEC, TORQUE_MAX, robots)
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
    whole, first, second = (Judge(SPEC, TORQUE_MAX, 4) for _ in range(3))
    feed(whole, series, range(ticks))
    feed(first, series, range(140))
    second.restore(first.save())
    feed(second, series, range(140, ticks))
    halves = [Judge(SPEC, TORQUE_MAX, 2) for _ in range(2)]
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
    asked, left = Judge(SPEC, TORQUE_MAX, 2), Judge(SPEC, TORQUE_MAX, 2)
    feed(left, series, range(ticks))
    for tick in range(ticks):
        feed(asked, series, [tick])
        assert asked.counts().ticks.tolist() == [tick + 1] * 2
    for field in fields(Counts):
        np.testing.assert_array_equal(
            getattr(asked.counts(), field.name), getattr(left.counts(), field.name), strict=True
        )


def test_counts_by_other_limits_do_not_merge():
    other = Judge(SPEC, 2 * TORQUE_MAX, 1).counts()
    with pytest.raises(ConfigError, match="limits"):
        merge(Judge(SPEC, TORQUE_MAX, 1).counts(), other)


def test_a_skipped_goal_is_a_goal_missed():
    bench = Bench()
    bench.step(round(5.5 * GOAL_S / DT))
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
    assert bench.fired() <= {"position_soft", "position_hard"}
    for name in ("velocity_sent", "acceleration", "jerk"):
        assert 0.99 < counts.worst[:, counts.columns(name)].max() <= 1
