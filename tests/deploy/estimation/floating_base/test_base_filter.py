from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from deploy.estimation.floating_base.base_faults import CONTRADICTED_S, GATE, NIS_S, RANGE, STUCK_S
from deploy.estimation.floating_base.base_measurements import Feet, Imu, Upright
from deploy.estimation.floating_base.base_model import G
from deploy.state import BaseState
from robots.rotations import matrix
from support.deploy.floating_bases import DT, LOOK_S, NOISE, F, World, base_filter, one, settled

STUCK_SAMPLES, NIS_SAMPLES = round(STUCK_S / DT), round(NIS_S / LOOK_S)
CONTRADICTED = round(CONTRADICTED_S / LOOK_S)

FIELDS = BaseState._fields[1:]


def assert_same(one, other):
    """Two states, bit for bit."""
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_yaw_is_unobservable_from_feet_and_gravity():
    """Who knows less of it goes on knowing exactly as much less, and of all the rest the same."""
    base, stream = settled()
    other, less = settled()[0], np.zeros((12, 12))
    less[2, 2] = 0.5
    other.P += less
    for packets in stream:
        base.step(*packets)
        state = other.step(*packets)
    np.testing.assert_allclose(other.P - base.P, [less, less], rtol=0, atol=1e-12)
    np.testing.assert_allclose(other.quat_wxyz, base.quat_wxyz, rtol=0, atol=1e-12)
    assert not state.diverged.any()


def test_yaw_variance_grows():
    base, stream = settled()
    before = base.P[:, 2, 2].copy()
    for packets in stream:
        base.step(*packets)
    assert (base.P[:, 2, 2] > before + 0.99 * len(stream) * DT * NOISE.gyro**2).all()


def test_only_the_heading_depends_on_the_initial_yaw():
    base, stream = settled()
    other, turn = settled()[0], Rotation.from_rotvec([0, 0, 2.0])
    other.quat_wxyz[:] = (turn * Rotation.from_quat(other.quat_wxyz, scalar_first=True)).as_quat(
        scalar_first=True
    )
    T = np.kron(np.diag([1, 0, 0, 0]), turn.as_matrix()) + np.diag([0] * 3 + [1] * 9)
    other.P[:] = T @ other.P @ T.T
    for packets in stream:
        state, turned = base.step(*packets), other.step(*packets)
    for name in ("velocity_in_base", "gravity", "angular_velocity"):
        np.testing.assert_allclose(getattr(turned, name), getattr(state, name), rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.P, T @ base.P @ T.T, rtol=0, atol=1e-9)
    np.testing.assert_allclose(turned.velocity_in_world, turn.apply(state.velocity_in_world), atol=1e-9)


@pytest.mark.slow
def test_robots_do_not_touch_each_other():
    """The row of 64 equals the row alone, bit for bit."""
    robots, some = 64, (0, 1, 30, 63)
    together, alone = base_filter(robots), {i: base_filter(1) for i in some}
    for t, imu, feet in World(6, robots, 230).packets(loss=0.2, lag_max=2, slipping=0.1):
        state = together.step(t, imu, feet)
        for i, base in alone.items():
            single = base.step(t, one(imu, slice(i, i + 1)), one(feet, slice(i, i + 1)))
            for name in FIELDS:
                np.testing.assert_array_equal(getattr(single, name)[0], getattr(state, name)[i], err_msg=name)
    for i, base in alone.items():
        np.testing.assert_array_equal(base.P[0], together.P[i])


def test_saved_and_restored_goes_on_bit_for_bit():
    base, stream = settled()
    saved = base.save()
    expected = [base.step(*packets) for packets in stream][-1]
    other = base_filter(2)
    assert {*base.carried, *base.parts} == {name for name in vars(base) if not name.startswith("_")}
    other.restore(saved)
    state = [other.step(*packets) for packets in stream][-1]
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(state, name), getattr(expected, name))


def test_prediction_to_now_leaves_the_filter_state_unchanged():
    base, stream = settled()
    other = settled()[0]
    t, imu, feet = stream[0]
    nothing = imu._replace(fresh=np.zeros(2, dtype=bool))
    early = base.step(t - 2 * DT, nothing, feet)
    np.testing.assert_array_equal(early.velocity_in_base, base.velocity)
    for late in np.linspace(0.0, 0.3, 20):
        base.step(t + late, nothing, feet)
    for name, values in other.save().items():
        np.testing.assert_array_equal(values, base.save()[name], err_msg=name)


BAD = {
    "old": lambda imu: imu._replace(t=imu.t - 0.1),
    "from the future": lambda imu: imu._replace(t=imu.t + 2.5 * DT),
    "at no time": lambda imu: imu._replace(t=imu.t + np.nan),
    "at minus infinity": lambda imu: imu._replace(t=imu.t - np.inf),
    "not a number": lambda imu: imu._replace(gyro=imu.gyro * np.nan),
    "of an accelerometer from the future": lambda imu: imu._replace(
        t_accelerometer=imu.t_accelerometer + 2.5 * DT
    ),
    "of an accelerometer at no time": lambda imu: imu._replace(t_accelerometer=imu.t_accelerometer + np.nan),
    "infinite": lambda imu: imu._replace(accelerometer=imu.accelerometer + np.inf),
    "beyond any sensor": lambda imu: imu._replace(gyro=imu.gyro + 1.1 * RANGE),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_packets_are_ignored(kind):
    base, stream = settled()
    clean = settled()[0]
    for tick, (t, imu, feet) in enumerate(stream):
        hit = np.array([False, 20 <= tick < 40])
        bad = Imu(
            *(
                np.where(hit.reshape(2, *[1] * (x.ndim - 1)), y, x)
                for x, y in zip(imu, BAD[kind](imu), strict=True)
            )
        )
        state = base.step(t, bad, feet)
        expected = clean.step(t, imu._replace(fresh=imu.fresh & ~hit), feet)
        assert_same(state, expected)


def test_foot_position_of_nan_counts_as_no_contact():
    base, stream = settled()
    clean = settled()[0]
    for t, imu, feet in stream:
        position, velocity = feet.position.copy(), feet.velocity.copy()
        position[0, 1, 2], velocity[1, 3, 0] = np.nan, np.inf
        stance = feet.stance.copy()
        stance[0, 1] = stance[1, 3] = False
        state = base.step(t, imu, Feet(stance=feet.stance, position=position, velocity=velocity))
        expected = clean.step(t, imu, feet._replace(stance=stance))
        assert_same(state._replace(height=expected.height), expected)


def test_grossly_slipping_foot_is_gated_out():
    base, stream = settled()
    clean = settled()[0]
    for t, imu, feet in stream:
        slips, stance = feet.velocity.copy(), feet.stance.copy()
        slips[:, 0] += [2.0, -1.0, 0.0]
        stance[:, 0] = False
        state = base.step(t, imu, feet._replace(velocity=slips))
        expected = clean.step(t, imu, feet._replace(stance=stance))
        np.testing.assert_allclose(state.velocity_in_base, expected.velocity_in_base, rtol=0, atol=1e-12)
        refused = (state.innovation[:, 0] ** 2).sum(axis=1) > GATE
        np.testing.assert_array_equal(refused, feet.stance[:, 0])
        assert not state.diverged.any()


def test_gate_rejects_one_good_foot_in_a_thousand():
    assert stats.chi2.sf(GATE, 3) == pytest.approx(1e-3, rel=0.01)


def test_age_grows_without_packets_and_covariance_with_it():
    base, stream = settled()
    ages, variances = [], []
    for tick, (t, imu, feet) in enumerate(stream[:60]):
        quiet = 10 <= tick < 50
        legs = feet._replace(stance=feet.stance & (tick != 50))
        state = base.step(t, imu._replace(fresh=imu.fresh & (not quiet)), legs)
        ages.append(state.age.copy())
        variances.append(np.einsum("bii->bi", base.P).copy())
    np.testing.assert_allclose(np.diff(ages, axis=0)[10:49], DT, rtol=1e-9)
    np.testing.assert_array_equal(variances[49], variances[9])
    assert (variances[50] > variances[49]).all()
    assert (variances[50][:, 3:6] > 2 * variances[49][:, 3:6]).all()
    assert state.age == pytest.approx(0.0, abs=1e-12)
    assert (variances[51][:, 3:6] < 0.5 * variances[50][:, 3:6]).all()


def test_gap_between_packets_is_integrated():
    """A known turn and push while nobody listened: both ends of the gap tell."""
    base = base_filter(1)
    feet = Feet(
        stance=np.zeros((1, F), dtype=bool), position=np.zeros((1, F, 3)), velocity=np.zeros((1, F, 3))
    )
    yes, up = np.ones(1, dtype=bool), np.array([[0.0, 0.0, G]])
    turning = np.array([[0.0, 0.0, 0.5]])
    begins, ends = np.zeros(1), np.full(1, 0.1)
    base.step(0.0, Imu(begins, yes, turning, up, begins), feet)
    state = base.step(0.1, Imu(ends, yes, turning, up + np.eye(1, 3), ends), feet)
    angle = Rotation.from_quat(state.quat_wxyz[0], scalar_first=True).as_rotvec()
    np.testing.assert_allclose(angle, [0, 0, 0.05], atol=1e-12)
    np.testing.assert_allclose(state.velocity_in_base, [[0.05, 0, 0]], atol=1e-12)


def test_silent_accelerometer_is_stale_and_not_stuck():
    """The gyro goes on with what it said last."""
    base, stream = settled()
    for tick, (t, imu, feet) in enumerate(stream[:40]):
        force, taken = imu.accelerometer.copy(), imu.t_accelerometer.copy()
        if tick >= 4:
            force[0], taken[0] = stream[4][1].accelerometer[0], stream[4][1].t_accelerometer[0]
        state = base.step(t, imu._replace(accelerometer=force, t_accelerometer=taken), feet)
        assert not state.stuck.any()
    assert state.age == pytest.approx([35 * DT, 0.0])
    assert (base.t_sample == imu.t).all()


@pytest.mark.parametrize("which", ["gyro", "accelerometer"])
def test_repeated_readings_are_detected_as_stuck_and_ignored(which):
    base, stream = settled()
    held = getattr(stream[4][1], which)
    for tick, (t, imu, feet) in enumerate(stream[:40]):
        values = getattr(imu, which).copy()
        if 4 <= tick < 30:
            values[0] = held[0]
        state = base.step(t, imu._replace(**{which: values}), feet)
        assert state.stuck.tolist() == [4 + STUCK_SAMPLES - 1 <= tick < 30, False]
        if tick == 29:
            assert state.age[0] == pytest.approx((26 - STUCK_SAMPLES + 1) * DT)
    assert state.age[0] == pytest.approx(0.0, abs=1e-12)


def test_filter_contradicted_by_all_feet_has_diverged():
    base, stream = settled()
    told = []
    for t, imu, feet in stream[: 3 * NIS_SAMPLES]:
        wrong = feet.velocity.copy()
        wrong[0] += [3.0, 0.0, 0.0]
        told.append(base.step(t, imu, feet._replace(velocity=wrong)).diverged)
    assert not np.array(told)[:, 1].any()
    assert np.array(told)[NIS_SAMPLES:, 0].all()


@pytest.mark.parametrize(
    ("errors", "std_max"), [([0, 1], 0.5), ([3], 2.0), ([4], 2.0), ([5], 2.0), ([2], np.inf)]
)
def test_filter_with_too_large_a_covariance_has_diverged(errors, std_max):
    """Of tilt, both ways together, or of speed; yaw, which nothing tells, is not asked."""
    for share in (0.99, 1.01):
        base, stream = settled()
        t, imu, feet = stream[0]
        base.P[0, errors, :] = base.P[0, :, errors] = 0.0
        base.P[0, errors, errors] = share * min(std_max, 1e3) ** 2 / len(errors)
        state = base.step(t - DT, imu._replace(fresh=np.zeros(2, dtype=bool)), feet)
        assert state.diverged.tolist() == [share > 1 and std_max < 1e3, False]


@pytest.mark.parametrize("name", ["P", "velocity", "bias", "quat_wxyz"])
def test_state_with_nan_is_invalid_until_reset(name):
    base, stream = settled()
    clean = settled()[0]
    getattr(base, name)[0] = np.nan
    for packets in stream[:20]:
        state, expected = base.step(*packets), clean.step(*packets)
        assert state.diverged.tolist() == [True, False]
        np.testing.assert_array_equal(state.velocity_in_base[1], expected.velocity_in_base[1])
    base.reset(np.array([True, False]))
    t, imu, feet = stream[20]
    assert not base.step(t - DT, imu._replace(fresh=np.zeros(2, dtype=bool)), feet).diverged.any()
    still = imu._replace(accelerometer=np.tile([0.0, 0.0, G], (2, 1)))
    state = base.step(t, still, feet)
    assert not state.diverged.any()
    assert all(np.isfinite(getattr(state, field)).all() for field in FIELDS)


GARBAGE = np.array([0.0, 1.0, -1e4, 9e3, 1e300, 1e-300, np.inf, -np.inf, np.nan])


@pytest.mark.parametrize("seed", range(12))
def test_garbage_raises_nothing_and_stays_with_its_robot(seed):
    """In packets, and in the belief itself; where the estimate is no number, it says so."""
    rng, base, clean = (
        np.random.default_rng(seed),
        base_filter(2),
        base_filter(1),
    )
    for t, imu, feet in World(8, 2, 80).packets():
        imu.t[0] = rng.choice([t, t, t, t - 1e6, t - 1e300, np.nan])
        beliefs = (base.P, base.velocity) if rng.random() < 0.03 else ()
        for values in (imu.gyro, imu.accelerometer, feet.position, feet.velocity, *beliefs):
            hit = rng.random(values[0].shape) < rng.choice([0.0, 0.1, 1.0], p=[0.8, 0.1, 0.1])
            values[0] = np.where(hit, rng.choice(GARBAGE, hit.shape), values[0])
        state = base.step(t, imu, feet)
        expected = clean.step(t, one(imu, slice(1, 2)), one(feet, slice(1, 2)))
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(state, name)[1], getattr(expected, name)[0])
            assert state.diverged[0] or not base.initialized[0] or np.isfinite(getattr(state, name)[0]).all()


def test_reset_of_a_subset():
    base, stream = settled()
    kept = settled()[0]
    base.reset(np.array([True, False]))
    t, imu, feet = stream[0]
    state, expected = (
        base.step(t, imu._replace(fresh=np.zeros(2, dtype=bool)), feet),
        kept.step(t, imu._replace(fresh=np.zeros(2, dtype=bool)), feet),
    )
    assert np.isinf(state.age).tolist() == [True, False]
    np.testing.assert_array_equal(state.velocity_in_base[1], expected.velocity_in_base[1])
    still = np.array([[0.0, 0.0, G], [0.0, 0.0, G]])
    state = base.step(t + DT, imu._replace(t=imu.t + DT, accelerometer=still), feet)
    np.testing.assert_allclose(state.gravity[0], [0, 0, -1], atol=1e-12)
    np.testing.assert_array_equal(state.velocity_in_base[0], 0.0)
    np.testing.assert_array_equal(state.innovation[0], 0.0)


@settings(max_examples=50)
@given(up=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda up: np.linalg.norm(up) > 0.1))
def test_gravity_initializes_the_tilt_only(up):
    up = np.array(up) / np.linalg.norm(up)
    base = base_filter(1)
    feet = Feet(stance=np.ones((1, F), dtype=bool), position=np.ones((1, F, 3)), velocity=np.ones((1, F, 3)))
    state = base.step(
        0.0, Imu(np.zeros(1), np.ones(1, dtype=bool), np.ones((1, 3)), G * up[None], np.zeros(1)), feet
    )
    np.testing.assert_allclose(state.gravity[0], -up, atol=1e-12)
    ahead = Rotation.from_quat(state.quat_wxyz[0], scalar_first=True).apply([1.0, 0.0, 0.0])
    assert ahead[1] == pytest.approx(0.0, abs=1e-12)
    assert ahead[0] > -1e-12
    np.testing.assert_array_equal(state.velocity_in_base, 0.0)
    assert base.P[0, 2, 2] == 0.0


def test_no_initialization_in_free_fall_or_at_negative_time():
    base = base_filter(4)
    feet = Feet(np.zeros((4, F), dtype=bool), *np.zeros((2, 4, F, 3)))
    force = np.outer([0.1, 2.0, 1.0, 1.0], [0.0, 0.0, G])
    t = np.array([0.0, 0.0, 0.0, -np.inf])
    state = base.step(0.0, Imu(t, np.ones(4, dtype=bool), np.zeros((4, 3)), force, t), feet)
    assert np.isinf(state.age).tolist() == [True, True, False, True]
    assert not base.initialized[3]
    assert not state.diverged.any()


@settings(max_examples=8)
@given(seed=st.integers(0, 2**31), loss=st.floats(0, 0.95))
@pytest.mark.slow
def test_covariance_stays_symmetric_and_positive(seed, loss):
    base = base_filter(4)
    for t, imu, feet in World(seed, 4, 250).packets(loss, lag_max=2, slipping=0.1):
        state = base.step(t, imu, feet)
    np.testing.assert_array_equal(base.P, base.P.swapaxes(1, 2))
    assert (np.linalg.eigvalsh(base.P) > -1e-12).all()
    np.testing.assert_allclose(np.linalg.norm(state.quat_wxyz, axis=1), 1.0, atol=1e-14)
    assert all(np.isfinite(getattr(state, name)).all() for name in FIELDS)


def test_more_noise_gives_more_variance():
    stream = list(World(9, 2, 150).packets())
    quiet, loud = base_filter(2), base_filter(2, replace(NOISE, slip=2 * NOISE.slip))
    for packets in stream:
        quiet.step(*packets)
        loud.step(*packets)
    speeds = range(3, 6)
    assert (loud.P[:, speeds, speeds] > quiet.P[:, speeds, speeds]).all()


def said_upright(world, k, variance, rng):
    """What an IMU that estimates its own tilt says, as wrong as it says."""
    up = np.eye(3)[2]
    lean = np.sqrt(variance) * rng.normal(size=world.v[k].shape) * [1, 1, 0]
    seen = np.vecmat(up + np.cross(lean, up), world.R[k])
    return Upright(np.ones(len(lean), dtype=bool), seen, variance, variance)


@cache
def long_walk(ticks):
    world = World(5, 64, ticks)
    return world, list(world.packets())


def tilt_errors(*, told, feet=False, ticks=2000):
    """(B,) rad, and what the filter says of them, after a while with or without being told where up is."""
    (world, stream), rng, robots = long_walk(ticks), np.random.default_rng(6), 64
    base = base_filter(robots)
    for t, imu, legs in stream:
        upright = said_upright(world, round(t / DT), 1e-4, rng) if told else None
        state = base.step(t, imu, legs._replace(stance=legs.stance & feet), upright)
    leans = np.matvec(matrix(state.quat_wxyz), world.R[ticks - 1][:, 2])
    return leans[:, :2], base.P[:, [1, 0], [1, 0]]


@pytest.mark.slow
def test_measured_gravity_direction_makes_tilt_observable_without_feet():
    alone, _ = tilt_errors(told=False)
    told, variance = tilt_errors(told=True)
    assert np.sqrt((told**2).mean()) < 0.005
    assert np.sqrt((alone**2).mean()) > 0.02
    assert 0.7 < (told**2 / variance).mean() < 1.4


def test_implausible_gravity_direction_is_rejected():
    world, base = World(7, 2, 200), base_filter(2)
    for t, imu, legs in world.packets():
        quiet = base.step(t, imu, legs)
    down = Upright(np.array([True, False]), np.tile([0.0, 0.0, -1.0], (2, 1)), 1e-4, 1e-4)
    np.testing.assert_array_equal(
        base.step(t, imu._replace(fresh=np.zeros(2, dtype=bool)), legs, down).gravity, quiet.gravity
    )


def test_repeatedly_contradicted_gravity_direction_is_a_divergence():
    """What it believes of up would otherwise be believed on its back."""
    world, base = World(7, 2, 200), base_filter(2)
    for t, imu, legs in world.packets():
        base.step(t, imu, legs)
    silent = imu._replace(fresh=np.zeros(2, dtype=bool))
    down = Upright(np.array([True, False]), np.tile([0.0, 0.0, -1.0], (2, 1)), 1e-4, 1e-4)
    lost = [base.step(t, silent, legs, down).diverged.tolist() for _ in range(CONTRADICTED)]
    assert lost == [[False, False]] * (CONTRADICTED - 1) + [[True, False]]


def test_one_consistent_gravity_direction_clears_the_count():
    world, base = World(7, 1, 200), base_filter(1)
    for t, imu, legs in world.packets():
        up = -base.step(t, imu, legs).gravity
    silent, told = imu._replace(fresh=np.zeros(1, dtype=bool)), np.ones(1, dtype=bool)
    for _ in range(3):
        for _ in range(CONTRADICTED - 1):
            assert not base.step(t, silent, legs, Upright(told, -up, 1e-4, 1e-2)).diverged.any()
        assert not base.step(t, silent, legs, Upright(told, up, 1e-4, 1e-2)).diverged.any()
