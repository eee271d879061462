"""The stages that stand in for those of the stack, and what the lines of the bench measure with them."""

from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from support.arm6 import SPEC

pytest.importorskip("mujoco")

from deploy.estimation.estimator import Estimator
from deploy.estimation.winding_observer import WindingObserver
from deploy.state import Packet, Setpoint
from eval.bench.ablation import ablation, heat_guard
from eval.bench.ablation.metrics import MetricsRecorder
from eval.bench.ablation.stage_variants import (
    VARIANTS,
    HeatBlindEstimator,
    HousingTemperatureObserver,
    LatestPacketEstimator,
    UncompensatedEstimator,
    UnlimitedSmoother,
)
from eval.bench.trial import Trial
from robots.distributions import load_distributions
from robots.draws import draw
from robots.motors.motor import MotorHeat, temperatures
from robots.motors.windings import nominal_windings
from robots.randomness import robot_seed

N, DT = SPEC.n, SPEC.dt
RATE, BEND = 0.3, 0.8


def where(t):
    """rad, a motion that was sent, and its speed: the same for every joint."""
    q = np.full((1, N), RATE * t + BEND * t * t / 2)
    return q, np.full((1, N), RATE + BEND * t)


def heard(t, value, *, fresh=True, housing=30.0, current=0.0):
    """What the bus delivers: an angle (1, N) that was taken at t."""
    taken, flag = np.array([t]), np.array([fresh])
    rest = np.zeros((1, N))
    values = {"encoder": value, "temperature": rest + housing, "current": rest + current}
    return {kind: Packet(t=taken, fresh=flag, value=what) for kind, what in values.items()}


def follow(stage, ticks=100, late=2, off=0.01):
    """The stage's state after some ticks of packets that are late by whole ticks, `off` rad from what was sent."""
    rest = Setpoint(q=where(0)[0], qd=np.zeros((1, N)), qdd=np.zeros((1, N)))
    stage.follow(np.array([True]), rest._replace(q=np.zeros((1, N))), rest)
    for tick in range(late, ticks):
        q, qd = where(tick * DT)
        taken = (tick - late) * DT
        state = stage.step(tick * DT, heard(taken, where(taken)[0] + off), Setpoint(q=q, qd=qd, qdd=qd))
    return state


def test_estimator_without_filter_returns_the_newest_packets():
    stage = LatestPacketEstimator(SPEC, 1)
    state, taken = follow(stage), 97 * DT
    np.testing.assert_array_equal(state.q, where(taken)[0] + 0.01)
    np.testing.assert_allclose(state.qd, (where(taken)[0] - where(taken - DT)[0]) / DT)
    assert state.age == pytest.approx(2 * DT)


def test_lost_or_old_packets_are_ignored_and_the_next_one_spans_the_gap():
    stage, still = LatestPacketEstimator(SPEC, 1), Setpoint(*np.zeros((3, 1, N)))
    for tick, taken, value in ((2, 0, 0.0), (3, 1, 0.01), (4, 1, 0.01), (5, 1, 0.01)):
        state = stage.step(tick * DT, heard(taken * DT, np.full((1, N), value)), still)
    np.testing.assert_allclose(state.qd, 0.01 / DT)
    state = stage.step(6 * DT, heard(4 * DT, np.full((1, N), 0.04)), still)
    np.testing.assert_allclose((state.q, state.qd), (np.full((1, N), 0.04), np.full((1, N), 0.03 / (3 * DT))))


def test_estimator_without_delay_compensation_returns_the_state_at_sampling():
    late, now = follow(UncompensatedEstimator(SPEC, 1)), follow(Estimator(SPEC, 1))
    then, t = 97 * DT, 99 * DT
    np.testing.assert_allclose(now.q - where(t)[0], 0.01, atol=1e-4)
    np.testing.assert_allclose(late.q - where(then)[0], 0.01, atol=1e-4)
    np.testing.assert_allclose(now.qd - late.qd, where(t)[1] - where(then)[1], atol=1e-9)


def test_without_a_smoother_the_target_is_sent_and_derivatives_are_its_differences():
    stage, rng, sent = UnlimitedSmoother(SPEC, 2), np.random.default_rng(0), [np.zeros((2, N))] * 2
    stopping = np.zeros(2, dtype=bool)
    low, high = (SPEC.joint_array(f"q_{end}") for end in ("min", "max"))
    margin = SPEC.margins.q_target_rad
    for _ in range(10):
        target = rng.uniform(-4, 4, (2, N))
        point = stage.next(target, stopping)
        np.testing.assert_array_equal(point.q, np.clip(target, low + margin, high - margin))
        sent.append(point.q)
        stage.commit(point)
    np.testing.assert_allclose(point.qd, np.diff(sent, axis=0)[-1] / DT)
    np.testing.assert_allclose(point.qdd, np.diff(sent, 2, axis=0)[-1] / DT**2)
    stop = stage.brake(point)
    for q in (stop.ahead.q, *stop.q, stop.q_rest, stage.next(target + 1.0, ~stopping).q):
        np.testing.assert_array_equal(q, point.q)
    np.testing.assert_array_equal(stop.ahead.qd, 0.0)


@pytest.mark.parametrize(("kind", "folds"), [(WindingObserver, True), (HousingTemperatureObserver, False)])
def test_runtime_without_winding_guard_has_no_winding_estimate(kind, folds):
    heat = kind(SPEC, 1)
    for tick in range(round(20 / DT)):
        heat.step(tick * DT, heard(tick * DT, np.zeros((1, N)), housing=75.0, current=10.0 + tick * 1e-6))
    assert (heat.foldback.current_share < 1).all() == (heat.foldback.speed_share < 1).all() == folds
    assert (heat.winding > 76).all() == (heat.hottest > 79).all() == folds
    assert (heat.hottest >= heat.winding).all()


def moving(power_from=0, ticks=400):
    """What a robot does that is known: amplitude 0.5 rad at 2 Hz, tracked with 3 mrad; and its figures."""
    robot = SimpleNamespace(
        robots=1, plant=SimpleNamespace(kinematics=SimpleNamespace(motor_q=np.zeros((1, N))))
    )
    runtime, counts = (
        SimpleNamespace(spec=SPEC),
        SimpleNamespace(goal_success=0.5, availability=0.25, hours=2.0),
    )
    counts.stops, counts.total = np.array([3]), lambda name: 4 if name == "torque" else 0
    judge = SimpleNamespace(counts=lambda: counts)
    trial = SimpleNamespace(
        robot=robot, runtime=runtime, judge=judge, copper_loss=lambda: np.full((1, N), 2.0)
    )
    recorder, w = MetricsRecorder(trial), 2 * np.pi * 2
    for tick in range(ticks):
        q = np.full((1, N), 0.5 * np.sin(w * tick * DT)) + (tick < power_from) * tick % 2
        robot.plant.kinematics.motor_q[:] = q
        robot.truth = lambda q=q: SimpleNamespace(
            q=q, valid=np.array([True]), winding_c=np.full((1, N), 60.0)
        )
        runtime.command = SimpleNamespace(q=q + 0.003, powered=np.array([tick >= power_from]))
        recorder.record()
    return recorder.metrics(), 0.5 * w**3 / np.sqrt(2)


@pytest.mark.parametrize("power_from", [0, 200])
def test_figures_equal_those_of_a_known_motion(power_from):
    """Two periods of it, or four; what a robot does without power does not count."""
    metrics, jerk = moving(power_from)
    assert metrics.jerk == pytest.approx(jerk, rel=0.02)
    assert metrics.tracking_error == pytest.approx(3.0)
    assert (metrics.winding, metrics.copper_loss) == (60.0, 2.0)
    assert (metrics.goals, metrics.running, metrics.stops, metrics.hard_events) == (50.0, 25.0, 1.5, 2.0)
    assert metrics.hard_monitors == "torque 4"


def test_every_variant_runs_and_has_a_row_and_a_figure(arm_policy, monkeypatch, tmp_path):
    monkeypatch.setattr(ablation, "ROBOTS", 1)
    monkeypatch.setattr(ablation, "TRIAL_S", 0.25)
    console, picture = Console(record=True, width=160), tmp_path / "figures.png"
    ablation.ablation(SPEC, arm_policy, console, picture)
    rows = [line for line in console.export_text().splitlines() if line.startswith("│")]
    assert [row.split("│")[1].strip() for row in rows[-len(VARIANTS) :]] == list(VARIANTS)
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_swaps_one_stage(name, arm_policy):
    runtime = Trial(SPEC, arm_policy, [robot_seed(1, 0)]).runtime
    before = parts(runtime)
    VARIANTS[name](runtime)
    swapped = [stage for stage, kind in parts(runtime).items() if kind is not before[stage]]
    assert len(swapped) == (name != "whole stack")


def parts(runtime):
    stages = {
        name: type(getattr(runtime, name)) for name in ("estimator", "smoother", "safety", "supervisor")
    }
    return {**stages, "heat": type(runtime.estimator.windings)}


def test_constant_losses_lead_to_the_closed_form():
    motors = nominal_windings(SPEC)
    away, ambient, current = SPEC.motor_array("housing_resistance_k_per_w"), 40.0, 3.0
    capacity = SPEC.motor_array("housing_capacity_j_per_k")
    winding, housing = heat_guard.steady(
        (current**2 * motors.resistance)[None],
        np.zeros((1, N)),
        np.full((1, 1), ambient),
        motors,
        motors.to_housing,
        away,
    )
    heat = MotorHeat(
        resistance=motors.resistance[0],
        alpha=motors.alpha[0],
        reference_c=motors.reference_c[0],
        winding_to_housing=motors.to_housing[0],
        housing_to_ambient=away[0],
        winding_capacity=motors.capacity[0],
        housing_capacity=capacity[0],
    )
    expected = temperatures(heat, current, ambient, 1e6)
    np.testing.assert_allclose((winding[0, 0], housing[0, 0]), expected, rtol=1e-6)


def test_friction_heats_the_housing_only():
    motors, away = nominal_windings(SPEC), SPEC.motor_array("housing_resistance_k_per_w")
    copper, rubbed = np.full((1, N), 2.0), np.full((1, N), 3.0)
    winding, housing = heat_guard.steady(
        copper, rubbed, np.full((1, 1), 20.0), motors, motors.to_housing, away
    )
    through = (winding - housing) / motors.to_housing
    np.testing.assert_allclose(through, copper * (1 + motors.alpha * (winding - motors.reference_c)))
    np.testing.assert_allclose((housing - 20.0) / away, through + rubbed)


def test_hot_draw_changes_masses_and_ambient_temperature_only():
    who = [3, 8]
    usual = draw(load_distributions(SPEC), SPEC, [robot_seed(heat_guard.SEED, robot) for robot in who])
    given = heat_guard.hot_draw(SPEC, who)
    changed = {name for name in usual if not np.array_equal(usual[name], given[name])}
    assert changed == {"links.mass", "payload.mass_kg", "climate.ambient_c"}
    np.testing.assert_allclose(given["links.mass"], 1.2 * usual["links.mass"])
    np.testing.assert_allclose(given["payload.mass_kg"], 1.2 * usual["payload.mass_kg"])
    np.testing.assert_allclose(given["climate.ambient_c"], usual["climate.ambient_c"] + 15.0)
    begun = heat_guard.warm_start(SPEC, given, np.array([62.0, 200.0]))
    warm = begun["climate.warm_start_k"] + begun["climate.ambient_c"]
    np.testing.assert_allclose(
        warm, [62.0, SPEC.motor_array("housing_max_c").min() - heat_guard.START_MARGIN_K]
    )


def test_unguarded_robot_neither_folds_back_nor_stops_for_heat():
    stage, still = HeatBlindEstimator(SPEC, 1), Setpoint(*np.zeros((3, 1, N)))
    state = stage.step(0.0, heard(0.0, np.zeros((1, N)), housing=149.0, current=30.0), still)
    assert not state.winding_c.any()
    assert not state.hottest_c.any()
    assert not state.housing_c.any()
    assert (state.current_share == 1.0).all()


@pytest.mark.slow
def test_hot_shift_of_resting_robots(arm_policy, monkeypatch):
    """A row for each robot and variant; what it lacks of the limit is what its winding has not reached."""
    small = {"CANDIDATES": 3, "CANDIDATE_S": 1.0, "ROBOTS": 2, "TRIAL_S": 3.0}
    for name, value in small.items():
        monkeypatch.setattr(heat_guard, name, value)
    console = Console(record=True, width=160)
    heat_guard.heat_guard(SPEC, arm_policy, console)
    text = console.export_text()
    rows = [
        [cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if line.startswith("│")
    ]
    assert [row[2] for row in rows] == ["with the guard", "without"] * 2
    for row in rows:
        assert float(row[3]) + float(row[4]) == pytest.approx(110.0, abs=0.11)
    assert "windings beyond their hard limit: 0 robots with the guard, 0 without" in text
