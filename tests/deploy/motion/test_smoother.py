import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Ruckig, Synchronization, Trajectory

from deploy.motion import ruckig_planner
from deploy.motion.smoother import Smoother
from deploy.state import Setpoint
from robots.models.blocks import BLOCK
from support.arm6 import SPEC

N, DT = SPEC.n, SPEC.dt
HOME = SPEC.joint_array("q_home")
V = SPEC.margins.speed * SPEC.joint_array("qd_max")
A, J = SPEC.joint_array("qdd_max"), SPEC.joint_array("qddd_max")
LOW, HIGH = (SPEC.joint_array(f"q_{end}") for end in ("min", "max"))
CLAMP_LOW, CLAMP_HIGH = LOW + SPEC.margins.q_target_rad, HIGH - SPEC.margins.q_target_rad


def at_home(robots):
    smoother = Smoother(SPEC, robots)
    smoother.hold(np.ones(robots, dtype=bool), np.tile(HOME, (robots, 1)))
    return smoother


def ride(smoother, targets, stops):
    """Every angle sent, from rest on; `targets` (T, B, n), `stops` (T, B)."""
    sent = [smoother.q.copy()] * 4
    for target, stopping in zip(targets, stops, strict=True):
        smoother.commit(smoother.next(target, stopping))
        sent.append(smoother.q.copy())
    return np.array(sent)


def assert_inside_limits(sent):
    """By backward differences of what was sent, as a stranger would: nobody's word is taken for it."""
    derivative = sent
    for limit in (V, A, J):
        derivative = np.diff(derivative, axis=0) / DT
        excess = np.abs(derivative).max(axis=(0, 1)) / limit
        assert (excess <= 1 + 1e-5).all(), excess


def never(ticks, robots):
    return np.zeros((ticks, robots), dtype=bool)


def attack(kind, rng, ticks, robots):
    """Targets that hurt."""
    shape = (ticks, robots, N)
    if kind == "random":
        return rng.uniform(LOW - 2, HIGH + 2, shape)
    if kind == "ends":
        return np.where(rng.random(shape) < 0.5, LOW - 9, HIGH + 9)
    if kind == "seldom":
        return np.repeat(rng.uniform(LOW - 1, HIGH + 1, (ticks // 50, robots, N)), 50, axis=0)
    if kind == "near":
        return HOME + rng.normal(0, 1e-9, shape)
    if kind == "square":
        period = rng.integers(5, 200, (robots, N))
        return np.where((np.arange(ticks)[:, None, None] // period) % 2, LOW, HIGH)
    return HOME + np.cumsum(rng.uniform(-0.05, 0.05, shape), axis=0)  # walk


@pytest.mark.parametrize("kind", ["random", "ends", "seldom", "near", "square", "walk"])
def test_every_target_stays_within_limits(kind):
    ticks, robots = 1500, 8
    sent = ride(at_home(robots), attack(kind, np.random.default_rng(1), ticks, robots), never(ticks, robots))
    assert_inside_limits(sent)


@pytest.mark.parametrize("kind", ["random", "ends", "seldom", "square", "walk"])
def test_no_target_leaves_the_clamped_range(kind):
    ticks, robots = 1500, 8
    sent = ride(at_home(robots), attack(kind, np.random.default_rng(2), ticks, robots), never(ticks, robots))
    assert (sent >= CLAMP_LOW - 1e-6).all()
    assert (sent <= CLAMP_HIGH + 1e-6).all()


def test_stops_and_starts_at_any_time_stay_within_limits():
    rng, ticks, robots = np.random.default_rng(3), 3000, 8
    stops = np.repeat(rng.random((ticks // 20, robots)) < 0.3, 20, axis=0)
    sent = ride(at_home(robots), attack("seldom", rng, ticks, robots), stops)
    assert_inside_limits(sent)
    assert (sent >= LOW + SPEC.margins.q_soft_rad).all()
    assert (sent <= HIGH - SPEC.margins.q_soft_rad).all()


def test_reaches_a_target_and_rests_on_it():
    smoother, target = at_home(2), np.stack((HOME + 0.2, HOME - 0.2))
    sent = ride(smoother, np.tile(target, (400, 1, 1)), never(400, 2))
    np.testing.assert_allclose(sent[-10:], np.tile(target, (10, 1, 1)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(smoother.qd, 0.0, atol=1e-9)


def test_full_speed_is_used():
    """A limit that is never met would be a limit nobody asked for."""
    ticks = 800
    sent = ride(
        at_home(4), attack("ends", np.random.default_rng(0), ticks, 4)[::400].repeat(400, 0), never(ticks, 4)
    )
    assert (np.abs(np.diff(sent, axis=0)).max(axis=(0, 1)) / DT > 0.5 * V).all()


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), before=st.integers(1, 150))
def test_a_stop_ends_where_it_was_predicted(seed, before):
    """And after a bounded time, exactly at rest, however the neighbours go on."""
    rng, robots = np.random.default_rng(seed), 3
    smoother = at_home(robots)
    ride(
        smoother,
        np.repeat(attack("random", rng, 10, robots), before // 10 + 1, 0)[:before],
        never(before, robots),
    )
    target, stopping = attack("random", rng, 1, robots)[0], np.array([True, False, True])
    planned = smoother.next(target, np.zeros(robots, dtype=bool))
    stop = smoother.brake(planned)
    first, end = stop.ahead, stop.q_rest
    smoother.commit(planned)
    step = smoother.next(target, stopping)
    np.testing.assert_allclose(step.q[stopping], first.q[stopping], rtol=0, atol=1e-9)
    for _ in range(150):
        smoother.commit(smoother.next(target, stopping))
    assert smoother.at_rest[stopping].all()
    np.testing.assert_allclose(smoother.q[stopping], end[stopping], rtol=0, atol=1e-6)


def test_braking_is_planned_without_touching_what_comes_next():
    one, other = at_home(2), at_home(2)
    for target in attack("seldom", np.random.default_rng(4), 300, 2):
        plan, plain = one.next(target, never(1, 2)[0]), other.next(target, never(1, 2)[0])
        one.brake(plan)
        np.testing.assert_array_equal(plan.q, plain.q)
        one.commit(plan)
        other.commit(plain)


@pytest.mark.slow
def test_robots_are_independent_to_the_bit():
    """Each on a schedule of its own, so that some trajectories are read long after their end while others go on."""
    robots, ticks, rng = BLOCK + 5, 300, np.random.default_rng(5)
    targets = np.empty((ticks, robots, N))
    for i, period in enumerate(rng.integers(20, 180, robots)):
        chosen = rng.uniform(LOW - 0.1, HIGH + 0.1, (ticks // period + 1, N))
        targets[:, i] = np.repeat(chosen, period, axis=0)[:ticks]
    stops = np.repeat(rng.random((ticks // 10, robots)) < 0.1, 10, axis=0)
    crowd, singles = at_home(robots), [at_home(1) for _ in range(robots)]
    for target, stopping in zip(targets, stops, strict=True):
        planned = crowd.next(target, stopping)
        stop = crowd.brake(planned)
        crowd.commit(planned)
        for i, single in enumerate(singles):
            one = slice(i, i + 1)
            alone = single.next(target[one], stopping[one])
            stop_alone = single.brake(alone)
            single.commit(alone)
            for mine, theirs in ((alone, planned), (stop_alone.ahead, stop.ahead)):
                for name in ("q", "qd", "qdd"):
                    np.testing.assert_array_equal(getattr(mine, name)[0], getattr(theirs, name)[i])
            for name in ("q", "qd", "qdd", "q_rest"):
                mine, theirs = getattr(stop_alone, name), getattr(stop, name)
                np.testing.assert_array_equal(mine[..., 0, :], theirs[..., i, :])


def test_robots_are_independent_when_trajectories_end_at_different_times():
    """There Ruckig computes in another order what began with an acceleration beyond the limit, be it by a rounding."""
    rng, crowd, free = np.random.default_rng(0), at_home(BLOCK), np.zeros(BLOCK, dtype=bool)
    crowd.qdd[:] = np.nextafter(A, np.inf) * rng.choice([-1, 1], (BLOCK, N))
    crowd.qd[:] = rng.uniform(-0.3, 0.3, (BLOCK, N))
    target = crowd.q + rng.uniform(-0.2, 0.2, (BLOCK, N))
    target[0] += 1.0
    singles = [at_home(1) for _ in range(BLOCK)]
    for i, single in enumerate(singles):
        single.qd[:], single.qdd[:] = crowd.qd[i], crowd.qdd[i]
    for _ in range(190):
        crowd.commit(crowd.next(target, free))
        for i, single in enumerate(singles):
            single.commit(single.next(target[i : i + 1], free[:1]))
            for name in ("q", "qd", "qdd"):
                np.testing.assert_array_equal(getattr(single, name)[0], getattr(crowd, name)[i])


def test_saved_and_restored_goes_on_bit_for_bit():
    targets, stops = attack("seldom", np.random.default_rng(6), 300, 3), never(300, 3)
    stops[120:160, 1] = True
    one, other = at_home(3), Smoother(SPEC, 3)
    ride(one, targets[:130], stops[:130])
    other.restore(one.save())
    np.testing.assert_array_equal(
        ride(other, targets[130:], stops[130:]), ride(one, targets[130:], stops[130:])
    )


def test_robot_on_its_plan_stays_on_the_trajectory():
    """To the bit, as one who plans once would ride it: no tick in between is a plan of its own."""
    smoother, target, ticks = moving(2), np.stack((HOME + 0.4, HOME - 0.3)), 60
    plan, path = InputParameter(2 * N), Trajectory(2 * N)
    plan.max_velocity, plan.max_acceleration, plan.max_jerk = (np.tile(limit, 2) for limit in (V, A, J))
    plan.current_position, plan.current_velocity = smoother.q.ravel(), smoother.qd.ravel()
    plan.current_acceleration, plan.target_position = smoother.qdd.ravel(), target.ravel()
    plan.synchronization = Synchronization.No
    Ruckig(2 * N).calculate(plan, path)
    ridden = ride(smoother, np.tile(target, (ticks, 1, 1)), never(ticks, 2))[4:]
    expected = [np.reshape(path.at_time(tick * DT)[0], (2, N)) for tick in range(1, ticks + 1)]
    np.testing.assert_array_equal(ridden, expected)


def test_displaced_robot_is_replanned():
    smoother, target = moving(3), np.tile(HOME + 0.4, (3, 1))
    ride(smoother, np.tile(target, (5, 1, 1)), never(5, 3))
    smoother.hold(np.array([False, True, False]), np.tile(HOME, (3, 1)))
    fresh = at_home(1)
    for _ in range(5):
        smoother.commit(smoother.next(target, np.zeros(3, dtype=bool)))
        fresh.commit(fresh.next(target[1:2], np.zeros(1, dtype=bool)))
        np.testing.assert_array_equal(smoother.q[1], fresh.q[0])


def test_robot_without_a_plan_changes_no_bit_of_others():
    """Where Ruckig fails for the block, each robot gets a trajectory of its own, as old as the one that it had."""
    clean, broken, target = moving(4), moving(4), np.tile(HOME + 0.4, (4, 1))
    others, free = np.arange(4) != 2, np.zeros(4, dtype=bool)
    for tick in range(60):
        if tick == 7:
            broken.qd[2, 1] = np.nan
        for smoother in (clean, broken):
            plan = smoother.next(target + tick // 20 * 0.1, free)
            smoother.commit(plan)
        np.testing.assert_array_equal(broken.q[others], clean.q[others])
    assert np.isnan(broken.q[2]).any()


@pytest.mark.parametrize("braking", [False, True])
def test_no_drift_at_long_rest(braking):
    ticks = 3000
    smoother, target = moving(2), np.stack((HOME + 0.4, HOME - 0.3))
    sent = ride(smoother, np.tile(target, (ticks, 1, 1)), np.full((ticks, 2), braking))
    assert smoother.at_rest.all()
    assert np.abs(np.diff(sent[500:], axis=0)).max() <= (0 if braking else 1e-15)
    np.testing.assert_allclose(sent[-1], sent[500], rtol=0, atol=1e-14)


def test_state_in_the_middle_of_a_stop():
    """From half its speed the slowest joint but one has four fifths of its way behind it."""
    smoother = at_home(1)
    joint = int(np.argsort(V / SPEC.joint_array("qdd_max"))[-2])
    smoother.qd[0, joint] = V[joint] / 2
    stop = smoother.brake(smoother.sent)
    way, whole = stop.q[2, 0] - HOME, stop.q_rest[0] - HOME
    assert 0.75 < way[joint] / whole[joint] < 0.85
    np.testing.assert_array_equal(np.delete(way, joint), 0.0)


def test_predicted_end_of_a_stop_is_exact_at_reduced_pace():
    """Two seconds and a half on its way, which is longer than trajectories are read otherwise."""
    slow = tuple(joint.model_copy(update={"qdd_max": 1.5, "qddd_max": 15.0}) for joint in SPEC.joints)
    smoother = Smoother(SPEC.model_copy(update={"joints": slow}), 1)
    smoother.commit(Setpoint(q=HOME[None], qd=V[None] * 0.9, qdd=np.full((1, N), 1.4)))
    end = smoother.brake(smoother.sent).q_rest
    ticks = 0
    while not smoother.at_rest[0]:
        smoother.commit(smoother.next(smoother.q, np.ones(1, dtype=bool)))
        ticks += 1
    assert 1.0 < ticks * SPEC.dt <= SPEC.model_copy(update={"joints": slow}).stop_s
    np.testing.assert_allclose(smoother.q, end, rtol=0, atol=1e-9)


def test_stop_continues_despite_new_targets():
    """On one trajectory: its age counts the ticks."""
    smoother, rng = moving(1), np.random.default_rng(0)
    for tick in range(1, 10):
        smoother.commit(smoother.next(rng.uniform(LOW, HIGH, (1, N)), np.array([True])))
        assert smoother.age.tolist() == [tick]


def moving(robots, seed=7):
    smoother = at_home(robots)
    ride(smoother, attack("walk", np.random.default_rng(seed), 60, robots), never(60, robots))
    return smoother


@pytest.mark.parametrize("field", ["q", "qd", "qdd"])
@pytest.mark.parametrize("robots", [1, 4, BLOCK + 2])
def test_robot_without_a_plan_gets_nan_and_others_their_plan(robots, field):
    """What Ruckig cannot plan must neither stop the others nor pass for a number."""
    clean, broken = moving(robots), moving(robots)
    getattr(broken, field)[robots // 2, 2] = np.nan
    target, free = np.tile(HOME, (robots, 1)), np.zeros(robots, dtype=bool)
    others = np.arange(robots) != robots // 2
    plan, expected = broken.next(target, free), clean.next(target, free)
    for name in ("q", "qd", "qdd"):
        assert np.isnan(getattr(plan, name)[~others]).all()
        np.testing.assert_array_equal(getattr(plan, name)[others], getattr(expected, name)[others])


def test_predicted_rest_is_right_beside_a_failed_plan():
    """The rest pose is what safety judges: it must be this tick's, not the last's."""
    clean, broken = moving(4), moving(4)
    broken.brake(Setpoint(q=clean.q, qd=clean.qd * 0, qdd=clean.qdd * 0))
    broken.qd[2, 1] = np.nan
    stop, expected = broken.brake(broken.sent), clean.brake(clean.sent)
    others = np.arange(4) != 2
    np.testing.assert_array_equal(stop.ahead.q[others], expected.ahead.q[others])
    np.testing.assert_array_equal(stop.q_rest[others], expected.q_rest[others])
    assert np.isnan(stop.q_rest[2]).all()


def test_plan_exists_where_two_profile_shapes_meet():
    """Found by the limit attack: Ruckig has no way from rest over exactly 2a³/j², and the robot would have latched."""
    smoother = at_home(1)
    smoother.q[0, 4], smoother.qd[0, 4] = -2.475, -5.204170427930421e-17
    target = smoother.q.copy()
    target[0, 4] = -2.5500000000000003
    expected = smoother.q.copy()
    expected[0, 4] -= J[4] * DT**3 / 6
    np.testing.assert_allclose(smoother.next(target, np.array([False])).q, expected, rtol=0, atol=2e-9)


@pytest.mark.parametrize("robots", [1, 32])
def test_plan_exists_around_every_such_distance(robots):
    rng = np.random.default_rng(9)
    for ulps in range(-8, 9):
        smoother = at_home(robots)
        smoother.q += rng.integers(-40, 40, (robots, N)) * 0.005
        smoother.qd += rng.choice([0, 5e-17, -5e-17], (robots, N))
        sign = rng.choice([-1, 1], (robots, N))
        target = smoother.q + sign * 2 * A**3 / J**2
        target += ulps * np.spacing(target)
        plan = smoother.next(target, np.zeros(robots, dtype=bool))
        np.testing.assert_allclose(
            plan.qdd, np.sign(np.clip(target, CLAMP_LOW, CLAMP_HIGH) - smoother.q) * J * DT
        )


@pytest.mark.parametrize("scale", [1e-18, 1e-17, 1e-16, 1e-14, 1e-12, 1e-9, 1e-6])
def test_every_state_near_rest_has_a_plan_to_continue_and_to_stop(scale):
    rng, robots = np.random.default_rng(8), 64
    for braking in (False, True):
        for _ in range(10):
            smoother = at_home(robots)
            smoother.q += rng.uniform(-0.1, 0.1, (robots, N))
            smoother.qd += scale * rng.choice([-1, 0, 1], (robots, N)) * rng.random((robots, N))
            smoother.qdd += 100 * scale * rng.choice([-1, 0, 1], (robots, N)) * rng.random((robots, N))
            target = smoother.q + rng.choice([-0.3, -0.075, 0, 1e-9, 0.1], (robots, N))
            plan = smoother.next(target, np.full(robots, braking))
            assert np.isfinite(plan.q + plan.qd + plan.qdd).all()
    for _ in range(40):
        smoother.commit(smoother.next(target, np.ones(robots, dtype=bool)))
    assert smoother.at_rest.all()


def test_a_slow_joint_goes_to_a_target_that_is_hours_away():
    slow = SPEC.model_copy(update={"margins": SPEC.margins.model_copy(update={"speed": 1e-5})})
    smoother = Smoother(slow, 1)
    smoother.hold(np.ones(1, dtype=bool), HOME[None])
    sent = ride(smoother, np.full((200, 1, N), HIGH), never(200, 1))
    np.testing.assert_allclose(
        np.diff(sent[-2:, 0], axis=0)[0] / DT, 1e-5 * V / SPEC.margins.speed, rtol=1e-3
    )


def test_a_motion_that_takes_hours_has_no_plan(monkeypatch):
    """Ruckig has a result for it that Python knows no name of."""
    monkeypatch.setattr(ruckig_planner, "FAR_S", 1e9)
    slow = SPEC.model_copy(update={"margins": SPEC.margins.model_copy(update={"speed": 1e-5})})
    smoother = Smoother(slow, 1)
    smoother.hold(np.ones(1, dtype=bool), HOME[None])
    assert np.isnan(smoother.next(np.array([HIGH]), np.zeros(1, dtype=bool)).q).all()


def test_hold_rests_only_the_robots_named():
    smoother = moving(3)
    before = smoother.save()
    smoother.hold(np.array([False, True, False]), np.tile(HOME, (3, 1)))
    assert smoother.at_rest.tolist() == [False, True, False]
    np.testing.assert_array_equal(smoother.q[[0, 2]], before["q"][[0, 2]])
    np.testing.assert_array_equal(smoother.q[1], HOME)


def test_returns_from_beyond_the_clamped_range():
    """Armed within the soft range but beyond where targets may lie."""
    smoother = Smoother(SPEC, 1)
    start = (HIGH - SPEC.margins.q_soft_rad - 0.001)[None]
    smoother.hold(np.array([True]), start)
    sent = ride(smoother, np.tile(HIGH + 1, (300, 1, 1)), never(300, 1))
    assert (sent <= start + 1e-9).all()
    np.testing.assert_allclose(sent[-1, 0], CLAMP_HIGH, atol=1e-6)
    assert_inside_limits(sent)


def test_brakes_when_above_the_velocity_limit():
    """A speed beyond the limit, as only a fault could bring, is reduced, not an error."""
    smoother = at_home(1)
    smoother.qd[0, 0] = 1.2 * V[0]
    speeds = []
    for _ in range(100):
        smoother.commit(smoother.next(np.array([HIGH]), np.array([False])))
        speeds.append(abs(smoother.qd[0, 0]))
    assert np.isfinite(speeds).all()
    assert speeds[-1] <= V[0] * (1 + 1e-6)


def test_replanning_every_tick_is_as_fast_as_one_plan():
    """Found by others: at the speed limit, a replan may take a detour of seconds. None may here."""
    rng, robots = np.random.default_rng(10), 64
    smoother = at_home(robots)
    smoother.q[:] = rng.uniform(CLAMP_LOW, CLAMP_HIGH, (robots, N))
    target = np.where(rng.random((robots, N)) < 0.5, CLAMP_LOW, CLAMP_HIGH) + rng.uniform(
        -0.2, 0.2, (robots, N)
    )
    target = np.clip(target, CLAMP_LOW, CLAMP_HIGH)
    one = Ruckig(robots * N)
    plan, path = InputParameter(robots * N), Trajectory(robots * N)
    plan.max_velocity, plan.max_acceleration, plan.max_jerk = (np.tile(limit, robots) for limit in (V, A, J))
    plan.current_position, plan.target_position = smoother.q.ravel(), target.ravel()
    plan.synchronization = Synchronization.No
    one.calculate(plan, path)
    free, fast = np.zeros(robots, dtype=bool), 0.0
    for tick in range(1, 500):
        smoother.commit(smoother.next(target + tick % 2 * 1e-12, free))  # or it would stay on its way
        planned = np.reshape(path.at_time(tick * DT)[0], (robots, N))
        np.testing.assert_allclose(smoother.q, planned, rtol=0, atol=1e-5)
        fast = max(fast, np.abs(smoother.qd / V).max())
    assert fast > 0.999
