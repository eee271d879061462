"""Windings as the runtime believes them, and what it does when they get hot."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from deploy.estimation.foldback import STEPS, Foldback
from deploy.estimation.winding_observer import (
    CURRENT_MAX,
    PERIOD_S,
    STUCK_CHANCE,
    TIMEOUT_S,
    WindingObserver,
    stuck_repeats,
)
from robots.distributions import load_distributions
from robots.errors import RobotError
from robots.models.nominal_model import torque_max
from robots.motors.windings import nominal_windings
from robots.spec import load_robot
from robots.tables import Rates
from support.arm6 import SPEC, copy_of_arm
from support.deploy.thermal import (
    DT,
    FOLD_MIN,
    HARD,
    LIMIT,
    NOMINAL,
    PACE_MIN,
    SOFT,
    THERMAL,
    N,
    live,
    sample,
)

ACTUATOR_MAX = np.array([14.9] * 3 + [2.8] * 3)
"""A at the end of each actuator's range, as robot.toml works them out."""


def at(winding):
    """An observer that has just come to believe in windings of so many °C, under no current."""
    heat = WindingObserver(SPEC, 1)
    live(heat, sample(0.0, 30.0))
    heat.winding[:] = winding
    heat.housing[:] = winding  # nothing flows
    for _ in range(round(PERIOD_S / DT)):
        live(heat, sample(0.0, heat.housing))
    return heat


def test_windings_equal_those_that_mujoco_compiles():
    """Another reader of the same file."""
    model = pytest.importorskip("robots.models.mujoco_model").load_mujoco(SPEC)
    np.testing.assert_allclose(NOMINAL.resistance, model.actuator_gainprm[:, 0])
    np.testing.assert_allclose(NOMINAL.alpha, model.actuator_gainprm[:, 2])
    np.testing.assert_allclose(NOMINAL.reference_c, model.actuator_gainprm[:, 3])
    np.testing.assert_allclose(NOMINAL.constant, model.actuator_gainprm[:, 1] * model.actuator_gear[:, 0])
    np.testing.assert_allclose(NOMINAL.to_housing, model.actuator_dynprm[:, 2])
    np.testing.assert_allclose(NOMINAL.capacity, model.actuator_dynprm[:, 3])


@pytest.mark.parametrize("hz", [1, 4, 5, 7])
def test_a_slow_bus_warms_its_windings_at_every_tick(hz):
    """A housing that stays as it is, 0.6 of each current: a tick is longer than the pause between two temperatures."""
    spec = SPEC.model_copy(update={"rates": Rates(control_hz=hz, physics_hz=hz)})
    heat, current = WindingObserver(spec, 1), 0.6 * ACTUATOR_MAX
    for tick in range(20 * hz + 1):
        heat.step(tick / hz, {k: p._replace(t=p.t + tick / hz) for k, p in sample(current, 30.0).items()})
    loss = current**2 * NOMINAL.resistance * (1.0 + NOMINAL.alpha * (30.0 - NOMINAL.reference_c))
    rate = (
        1.0 / (NOMINAL.to_housing * NOMINAL.capacity)
        - current**2 * NOMINAL.resistance * NOMINAL.alpha / NOMINAL.capacity
    )
    expected = 30.0 + loss / NOMINAL.capacity * (1.0 - np.exp(-20.0 * rate)) / rate
    np.testing.assert_allclose(heat.winding[0], expected, rtol=0.06)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        (THERMAL[1], 'thermal="2.0 0 24 0.0039 25 25"', (2.0, 12.0)),
        (THERMAL[1], 'thermal="0 12 24 0.0039 25 25"', (2.0, 12.0)),
        (THERMAL[1], 'thermal="2.0 99 24 0.0039 25"', (2.0, 12.0)),
        (
            r'joint="wrist_3" class="size1"/>',
            'joint="wrist_3" class="size1" thermal="3 9 0 0.004"/>',
            (3.0, 9.0),
        ),
    ],
)
def test_windings_are_read_in_every_notation(tmp_path, old, new, found):
    windings = nominal_windings(load_robot(copy_of_arm(tmp_path, xml=[(old, new)])))
    assert (windings.to_housing[5], windings.capacity[5]) == pytest.approx(found)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (THERMAL[1], "", r"joint 'wrist_1': thermal: found None, expected up to 6 numbers"),
        (THERMAL[1], 'thermal="2 warm"', r"thermal: found '2 warm', expected up to 6 numbers"),
        (THERMAL[1], 'thermal="2 12 0 nan"', r"thermal: found '2 12 0 nan', expected"),
        (
            THERMAL[1],
            'thermal="2 0 0 0.0039 25 25"',
            r"found resistance 3 ohm, thermal '2 0 0 .*J/K and s above 0",
        ),
        (THERMAL[0], 'thermal="1.0 40 0 -0.1 25 25"', r"at least 0 /K"),
        (r'resistance="3.0"', 'resistance="-3"', r"found resistance -3 ohm"),
        (r'<dcmotor name="wrist_3" joint="wrist_3" class="size1"/>', "", r"no dcmotor on joint 'wrist_3'"),
    ],
)
def test_motors_whose_heat_cannot_be_known_are_refused(tmp_path, old, new, words):
    spec = load_robot(copy_of_arm(tmp_path, xml=[(old, new)]))
    with pytest.raises(RobotError, match=words) as caught:
        WindingObserver(spec, 1)
    assert "model.xml" in str(caught.value)


@pytest.mark.parametrize("name", ["winding_soft_c", "winding_k"])
def test_winding_margins_without_room_are_refused(tmp_path, name):
    old, new = {
        "winding_soft_c": ("winding_soft_c = 80.0", "winding_soft_c = 107.0"),
        "winding_k": ("winding_k = 3.0", "winding_k = 30.0"),
    }[name]
    with pytest.raises(RobotError, match=r"robot\.toml: .*motors\.size\d: winding_soft_c .* is not below"):
        load_robot(copy_of_arm(tmp_path, toml=[(old, new)]))


@pytest.mark.slow
def test_follows_the_equation_through_changing_current_and_housing():
    """To a tenth of a kelvin: the housing is measured, the current is not constant."""
    heat = WindingObserver(SPEC, 1)

    def current(t):
        return (0.3 + 0.25 * np.sin(2 * t) + 0.6 * (int(t) % 20 < 4)) * ACTUATOR_MAX

    def housing(t):
        return 30.0 + 10.0 * (1 - np.exp(-t / 60.0))

    def slope(t, winding):
        loss = current(t) ** 2 * NOMINAL.resistance * (1 + NOMINAL.alpha * (winding - NOMINAL.reference_c))
        return (loss - (winding - housing(t)) / NOMINAL.to_housing) / NOMINAL.capacity

    times = np.arange(round(120 / DT)) * DT
    found = []
    for t in times:
        live(heat, sample(current(t), housing(t)))
        found.append(heat.winding[0].copy())
    ends = times[19::20]
    expected = solve_ivp(
        slope, (0, times[-1] + DT), housing(0) * np.ones(N), t_eval=ends, max_step=0.02, rtol=1e-8
    )
    warmest = expected.y.max()
    assert warmest > 60
    np.testing.assert_allclose(np.array(found)[19::20], expected.y.T, rtol=0, atol=0.2)


def test_readings_of_nan_repeat_the_last_one():
    heat, clean, rng, whole = (
        WindingObserver(SPEC, 1),
        WindingObserver(SPEC, 1),
        np.random.default_rng(0),
        sample(0.0, 30.0),
    )
    for tick in range(400):
        lost, housing = tick % 7 == 3, 30.0 + tick // 100
        current = whole["current"].value if lost else sample(rng.uniform(0, 9, N), housing)["current"].value
        whole = {**sample(0.0, housing), "current": whole["current"]._replace(value=current)}
        live(clean, whole)
        live(heat, sample(np.nan, np.nan) if lost else whole)
    np.testing.assert_array_equal(heat.winding, clean.winding)
    assert (heat.winding > 30).all()


def test_readings_are_clipped_to_what_the_drive_can_supply():
    """Whatever a sensor says that has gone mad; half as much again as the drive's own limit still counts in full."""
    most, windings = CURRENT_MAX * torque_max(SPEC) / NOMINAL.constant, []
    for current in (0.99 * most, most, -2 * most, SPEC.sensors["current"].range):
        heat = WindingObserver(SPEC, 1)
        for _ in range(round(1.0 / DT)):
            live(heat, sample(current, 30.0))
        windings.append(heat.winding[0].copy())
    below, at_most, *beyond = windings
    assert (at_most > below + 0.05).all()
    np.testing.assert_allclose(beyond, [at_most] * 2, rtol=1e-6)


def test_no_current_reading_gives_no_winding_estimate():
    heat = WindingObserver(SPEC, 1)
    for _ in range(40):
        live(heat, sample(np.nan, 30.0))
    assert np.isnan(heat.winding).all()


@pytest.mark.parametrize(("current", "housing"), [(np.nan, 30.0), (2.0, np.nan), (np.nan, np.nan)])
def test_initialized_by_the_first_complete_sample(current, housing):
    """A bus whose packets come one after the other must not keep the robot from its shift."""
    heat, clean = WindingObserver(SPEC, 1), WindingObserver(SPEC, 1)
    for _ in range(60):
        live(heat, sample(current, housing))
    assert np.isnan(heat.winding).all()
    for _ in range(600):
        packets = sample(5.0, 31.0)
        live(heat, packets)
        live(clean, packets)
    np.testing.assert_array_equal(heat.winding, clean.winding)
    assert (heat.winding > 31).all()


@pytest.mark.parametrize("share", [-0.5, 0.0, 0.24, 0.5, 0.99, 1.0, 1.5])
def test_foldback_is_linear(share):
    heat = at(SOFT + share * (LIMIT - SOFT))
    shares = heat.foldback.current_share, heat.foldback.speed_share
    for found, least in zip(shares, (FOLD_MIN, PACE_MIN), strict=True):
        line = np.clip(1 - (1 - least) * share, least, 1)
        assert (found >= line - 1e-9).all()
        assert (found <= np.minimum(line + (1 - least) / STEPS, 1) + 1e-9).all()


def test_foldback_is_released_with_hysteresis():
    """A reading that goes to and fro by a kelvin changes nothing, however near to an edge it is."""
    foldback, band, margin = Foldback(SPEC, 1), LIMIT - SOFT, np.full((1, N), SPEC.margins.winding_k)
    step = band / STEPS
    for middle in np.linspace(0.4, 0.6, 21):
        folds = set()
        for noise in (0.45, -0.45) * 4:
            foldback.step((SOFT + middle * band + noise * step)[None], margin)
            folds.add(foldback.current_share[0, 0])
        assert len(folds) <= 2
        assert list(folds)[-1] == foldback.current_share[0, 0]
    foldback.step((SOFT - 0.6 * step)[None], margin)
    np.testing.assert_array_equal(foldback.current_share, 1.0)


@pytest.mark.parametrize("kind", ["current", "temperature"])
@pytest.mark.parametrize("how", ["late", "nan", "future", "timeless"])
def test_winding_estimate_is_invalid_after_long_silence(kind, how):
    """And believes in no cooler ones when it is heard again."""
    heat = at(SOFT - 5.0)
    t, known = (heat.lived + 1) * DT, heat.winding.copy()
    for tick in range(round((TIMEOUT_S + 0.3) / DT)):
        packets = sample(6.0, SOFT - 20.0)
        if how == "nan":
            packets[kind].value[0, 2] = np.nan
        odd = {"late": t, "future": t + 1e4, "timeless": np.nan}
        stamps = {k: odd.get(how, t + tick * DT) if k == kind else t + tick * DT for k in packets}
        late = {k: packet._replace(t=packet.t + stamps[k]) for k, packet in packets.items()}
        known = np.where(np.isfinite(heat.winding), heat.winding, known)
        heat.step(t + tick * DT, late)
        assert np.isfinite(heat.winding).all() or tick * DT > TIMEOUT_S - 0.2
    assert np.isnan(heat.winding).all()
    assert heat.foldback.speed_share[0] == PACE_MIN
    heat.lived += tick + 1
    live(heat, sample(6.0, SOFT - 20.0))
    np.testing.assert_allclose(heat.winding, known, rtol=0, atol=1.5)  # a period of warming


def test_pace_follows_the_hottest_motor():
    winding = SOFT - 20.0
    winding[3] = LIMIT[3]
    heat = at(winding)
    foldback = heat.foldback
    assert (foldback.speed_share[0], foldback.current_share[0, 3]) == (PACE_MIN, FOLD_MIN)
    np.testing.assert_array_equal(np.delete(foldback.current_share[0], 3), 1.0)


def test_initial_temperatures_come_from_the_last_run():
    """A winding that was 50 K above its housing is 50/e K above it after its time constant without power."""
    heat = WindingObserver(SPEC, 2)
    tau = NOMINAL.to_housing * NOMINAL.capacity
    heat.resume(np.full((2, N), 50.0), off_s=tau[0])
    live(heat, sample(0.0, [[35.0], [28.0]], 2))
    expected = np.array([[35.0], [28.0]]) + 50.0 * np.exp(-tau[0] / tau)
    np.testing.assert_allclose(heat.winding, expected)


def test_reset_of_a_subset():
    heat = WindingObserver(SPEC, 3)
    for _ in range(200):
        live(heat, sample(9.0, 30.0, 3))
    before = heat.winding.copy()
    heat.reset(np.array([False, True, False]))
    live(heat, sample(0.0, 25.0, 3))
    np.testing.assert_array_equal(heat.winding[1], 25.0)
    np.testing.assert_array_equal(heat.winding[[0, 2]], before[[0, 2]])


def test_saved_and_restored_goes_on_bit_for_bit():
    heat, other, rng = WindingObserver(SPEC, 2), WindingObserver(SPEC, 2), np.random.default_rng(1)
    for _ in range(123):
        live(heat, sample(rng.uniform(0, 12, (2, N)), 30.0, 2))
    saved = heat.save()
    rest = [sample(rng.uniform(0, 12, (2, N)), 31.0, 2) for _ in range(200)]
    other.restore(saved)
    other.lived = heat.lived
    for one in rest:
        live(heat, one)
        live(other, one)
    for name, expected in heat.save().items():
        np.testing.assert_array_equal(other.save()[name], expected)


@pytest.mark.slow
def test_winding_margin_covers_every_drawn_motor():
    """Each of the corners of draws.toml, under currents and in housings of any kind: the guard stops it before that."""
    spans = load_distributions(SPEC).drives
    corners = np.array(
        [
            [span.low, span.high]
            for span in (spans.resistance, spans.winding_to_housing, spans.winding_capacity)
        ]
    )
    cases = itertools.product(*corners, [15.0, 40.0, 65.0, 85.0], [0.5, 0.65, 0.8, 1.0])
    ohm, out, capacity, housing, share = np.array(list(cases)).T[..., None]
    current, true = share * ACTUATOR_MAX, np.repeat(housing, N, axis=1)
    heat, around, tau = (
        WindingObserver(SPEC, len(true)),
        true.copy(),
        PERIOD_S / (NOMINAL.capacity * capacity),
    )
    stopped = np.zeros(true.shape, dtype=bool)
    for tick in range(round(200 / DT)):
        live(heat, sample(current, around, len(true)))
        if (tick + 1) % round(PERIOD_S / DT):
            continue
        ohms = NOMINAL.resistance * ohm * (1 + NOMINAL.alpha * (true - NOMINAL.reference_c))
        true += tau * (current**2 * ohms - (true - around) / (NOMINAL.to_housing * out))
        stopped |= heat.hottest > HARD
        assert (stopped | (true < HARD)).all()
    assert stopped.reshape(8, -1).any(axis=1).all()


def test_constant_current_counts_as_stuck():
    """Neither by its noise: what it says now is not known, and without that no winding is."""
    heat, stuck, found = WindingObserver(SPEC, 2), sample(3.0, 30.0, 2), []
    for _ in range(round((TIMEOUT_S + 3.0) / DT)):
        packets = sample(3.0, 30.0, 2)
        packets["current"].value[1, 4] = stuck["current"].value[1, 4]
        live(heat, packets)
        found.append(np.isfinite(heat.winding).all(axis=1))
    assert np.all(found, axis=0).tolist() == [True, False]
    blind = np.argmin(np.array(found)[:, 1]) * DT
    assert TIMEOUT_S < blind < TIMEOUT_S + 2.0


def test_number_of_repeats_that_count_as_stuck():
    """By its own noise and steps: never by chance, and what is too coarse for its noise may stand still for ever."""
    current, rng = SPEC.sensors["current"], np.random.default_rng(3)
    most = stuck_repeats(current)
    readings = np.rint(rng.normal(0.0, current.noise / 2, 1_000_000) / current.resolution)
    again = np.mean(readings[1:] == readings[:-1])
    assert again ** (most - 1) > STUCK_CHANCE > 0.5 * again**most
    assert stuck_repeats(SPEC.sensors["temperature"]) == np.inf
    assert stuck_repeats(current.model_copy(update={"noise": 0.0})) == np.inf
    assert stuck_repeats(current.model_copy(update={"noise": 5e-324})) == np.inf
