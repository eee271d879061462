from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise, van_loan_discretization
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from deploy import floating_base
from deploy.base_model import G
from deploy.base_state import BaseNoise, Feet, Imu
from deploy.floating_base import GATE, NIS_SAMPLES, RANGE, STUCK_SAMPLES, FloatingBase

DT, F = 0.005, 4
NOISE = BaseNoise(
    gyro=5e-4,
    accelerometer=5e-3,
    gyro_walk=1e-4,
    accelerometer_walk=1e-3,
    gyro_bias=0.01,
    accelerometer_bias=0.1,
    slip=0.004,
    angular_acceleration=2.0,
    jerk=20.0,
)
FIELDS = floating_base.BaseState._fields[1:]
DOWN = np.array([0.0, 0.0, -G])


def cross(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


class World:
    """Robots that turn and accelerate smoothly, seen by IMUs as bad as NOISE says: `R`, `v` in the base, biases."""

    def __init__(self, seed, robots, ticks):
        rng = self.rng = np.random.default_rng(seed)
        t = DT * np.arange(ticks)[:, None, None]
        speed, phase = rng.uniform(2, 8, (2, robots, 3)), rng.uniform(0, 6, (2, robots, 3))
        self.w = 0.5 * np.sin(speed[0] * t + phase[0])
        a = (
            np.minimum(1.0, 5 * t) * 2.0 * np.sin(speed[1] * t + phase[1])
        )  # of the base, in the world; first none
        self.R, v = np.empty((ticks, robots, 3, 3)), np.zeros((ticks, robots, 3))
        self.R[0] = Rotation.from_rotvec(rng.normal(0, 0.05, (robots, 3)) * [1, 1, 0]).as_matrix()
        for k in range(1, ticks):
            turn = Rotation.from_rotvec(DT * (self.w[k - 1] + self.w[k]) / 2).as_matrix()
            self.R[k] = self.R[k - 1] @ turn
            v[k] = v[k - 1] + DT * (a[k - 1] + a[k]) / 2
        v += rng.normal(0, 0.3, (robots, 3))
        into_base = self.R.swapaxes(2, 3)
        self.v, self.f = (into_base @ v[..., None])[..., 0], (into_base @ (a - DOWN)[..., None])[..., 0]
        self.gyro_bias, self.force_bias = (
            bias * rng.standard_normal((robots, 3))
            + walk * np.sqrt(DT) * np.cumsum(rng.standard_normal((ticks, robots, 3)), axis=0)
            for bias, walk in (
                (NOISE.gyro_bias, NOISE.gyro_walk),
                (NOISE.accelerometer_bias, NOISE.accelerometer_walk),
            )
        )
        self.gyro, self.force = (
            value + bias + density / np.sqrt(DT) * rng.standard_normal(value.shape)
            for value, bias, density in (
                (self.w, self.gyro_bias, NOISE.gyro),
                (self.f, self.force_bias, NOISE.accelerometer),
            )
        )

    def feet(self, at, slipping=0.0):
        """Of the moments `at` (B,), some in the air, and some on ice."""
        rng, row = self.rng, np.arange(len(at))
        p = rng.uniform(-0.4, 0.4, (len(at), F, 3))
        slip = NOISE.slip / np.sqrt(DT) * rng.standard_normal(p.shape)
        slip += (rng.random((len(at), F, 1)) < slipping) * rng.normal(0, 1.0, p.shape)
        velocity = slip - self.v[at, row][:, None] - np.cross(self.w[at, row][:, None], p)
        return Feet(stance=rng.random((len(at), F)) < 0.7, position=p, velocity=velocity)

    def packets(self, loss=0.0, lag_max=0, slipping=0.0):
        """What an unkind bus delivers: each robot its own delay, losses, and old packets that come again."""
        rng, robots = self.rng, self.v.shape[1]
        lag, row = rng.integers(0, lag_max + 1, robots), np.arange(robots)
        for tick in range(lag_max + 3, len(self.v)):
            at = tick - lag - 3 * (rng.random(robots) < 0.05 * (lag_max > 0))
            fresh = rng.random(robots) >= loss
            if loss and tick % 150 > 130:
                fresh[0] = False  # and long outages
            imu = Imu(t=DT * at, fresh=fresh, gyro=self.gyro[at, row], accelerometer=self.force[at, row])
            yield DT * tick, imu, self.feet(at, slipping)


class ByFilterpy:
    """The oracle: one filter of filterpy's for each robot, with the matrices of the equations, written out."""

    def __init__(self, t, gyro, force):
        self.t, self.gyro, self.force = t, gyro, force
        up = force / np.linalg.norm(force)
        self.R = Rotation.from_euler("YX", [np.arctan2(-up[0], np.hypot(*up[1:])), np.arctan2(up[1], up[2])])
        self.v, self.bg, self.ba = np.zeros((3, 3))
        self.kf = ExtendedKalmanFilter(dim_x=12, dim_z=3)
        self.innovation = np.zeros((F, 3))
        # Tilt is the accelerometer's answer: its errors are those of rest and of the bias.
        tilt_by_bias = cross(np.array([0, 0, 1 / G])) @ self.R.as_matrix()
        bias = NOISE.accelerometer_bias**2 * np.eye(3)
        level = np.diag([1.0, 1.0, 0.0]) * floating_base.SEED_ACCELERATION_STD**2 / G**2
        P = np.zeros((12, 12))
        P[:3, :3] = tilt_by_bias @ bias @ tilt_by_bias.T + level
        P[:3, 9:], P[9:, :3], P[9:, 9:] = tilt_by_bias @ bias, bias @ tilt_by_bias.T, bias
        P[3:6, 3:6] = floating_base.SEED_SPEED_STD**2 * np.eye(3)
        P[6:9, 6:9] = NOISE.gyro_bias**2 * np.eye(3)
        self.kf.P = P

    def moved(self, dt, gyro, force, unseen):
        """R, v, F and Q after dt."""
        turn = Rotation.from_rotvec(dt * (gyro - self.bg))
        R = self.R * turn
        back, out = turn.as_matrix().T, R.as_matrix()
        carried = back @ (self.v + dt / 2 * (self.force - self.ba)) + dt * out.T @ DOWN
        none, one = np.zeros((3, 3)), np.eye(3)
        Fx = np.block(
            [
                [one, none, -dt * out, none],
                [dt * out.T @ cross(DOWN), back, -dt * cross(carried), -dt * one],
                [none, none, one, none],
                [none, none, none, one],
            ]
        )
        G_noise = np.block([[out, none], [cross(carried), one], [np.zeros((6, 6))]])
        white = [NOISE.gyro**2 * dt + NOISE.angular_acceleration**2 * unseen]
        white += [NOISE.accelerometer**2 * dt + NOISE.jerk**2 * unseen]
        walk = [0] * 6 + [NOISE.gyro_walk**2 * dt] * 3 + [NOISE.accelerometer_walk**2 * dt] * 3
        Q = G_noise @ np.diag(np.repeat(white, 3)) @ G_noise.T + np.diag(walk)
        return R, carried + dt / 2 * (force - self.ba), Fx, Q

    def fuse(self, t, gyro, force, feet):
        dt = t - self.t
        bridge = Q_continuous_white_noise(2, max(dt - DT, 0.0))[0, 0] / 4
        self.R, self.v, self.kf.F, self.kf.Q = self.moved(dt, (self.gyro + gyro) / 2, force, bridge)
        self.t, self.gyro, self.force = t, gyro, force
        self.kf.predict()
        P, x = self.kf.P.copy(), self.kf.x
        self.innovation = np.zeros((F, 3))
        for i in np.flatnonzero(feet.stance):
            y, H = self.seen(feet, i)
            S = H @ P @ H.T + NOISE.slip**2 / DT * np.eye(3)
            self.innovation[i] = np.linalg.solve(np.linalg.cholesky(S), y)
            if y @ np.linalg.solve(S, y) <= GATE:
                self.kf.update(
                    np.zeros((3, 1)),
                    HJacobian=lambda _, H=H: H,
                    Hx=lambda x, y=y, H=H: H @ x - y[:, None],
                    R=NOISE.slip**2 / DT,
                )
        error, self.kf.x = self.kf.x[:, 0], np.zeros_like(x)
        self.R = Rotation.from_rotvec(error[:3]) * self.R
        self.v, self.bg, self.ba = self.v + error[3:6], self.bg + error[6:9], self.ba + error[9:]

    def seen(self, feet, i):
        """How far a foot is from standing still, and by which errors."""
        p = feet.position[i]
        speed = self.v + np.cross(self.gyro - self.bg, p) + feet.velocity[i]
        return -speed, np.block([np.zeros((3, 3)), np.eye(3), cross(p), np.zeros((3, 3))])

    def now(self, t):
        """R, v and P, carried to now."""
        lag = t - self.t
        unseen = Q_continuous_white_noise(2, lag)[0, 0] if lag > 0 else 0.0
        R, v, Fx, Q = self.moved(lag, self.gyro, self.force, unseen)
        return R.as_matrix(), v, Fx @ self.kf.P @ Fx.T + Q


def one(record, robot):
    """The robot's own row."""
    return type(record)(*(values[robot] for values in record))


@pytest.mark.parametrize(("seed", "loss", "slipping"), [(0, 0.0, 0.0), (1, 0.2, 0.05), (2, 0.6, 0.2)])
def test_equals_filterpy(seed, loss, slipping):
    robots = 2
    base, oracles, refused = FloatingBase(NOISE, DT, robots, F), [None] * robots, 0
    for t, imu, feet in World(seed, robots, 260).packets(loss, lag_max=3, slipping=slipping):
        state = base.step(t, imu, feet)
        for robot in range(robots):
            oracle, packet = oracles[robot], one(imu, robot)
            if oracle is None and packet.fresh:
                oracle = oracles[robot] = ByFilterpy(packet.t, packet.gyro, packet.accelerometer)
            elif packet.fresh and packet.t > oracle.t:
                oracle.fuse(packet.t, packet.gyro, packet.accelerometer, one(feet, robot))
                refused += np.count_nonzero((oracle.innovation**2).sum(axis=1) > GATE)
            if oracle is not None:
                assert_equal(base, one(state._replace(t=np.full(robots, t)), robot), robot, oracle)
    assert all(oracles)
    assert (refused > 10) == (slipping > 0)


def assert_equal(base, state, robot, oracle):
    near = {"rtol": 0, "atol": 1e-9}
    np.testing.assert_allclose(base.P[robot], oracle.kf.P, **near)
    np.testing.assert_allclose(base.velocity[robot], oracle.v, **near)
    np.testing.assert_allclose(base.bias[robot, :3], oracle.bg, **near)
    np.testing.assert_allclose(base.bias[robot, 3:], oracle.ba, **near)
    R, v, P = oracle.now(state.t)
    var, out = np.diag(P), np.concatenate([-cross(R @ v), R], axis=1)
    tilt = R.T @ cross(np.array([0, 0, 1.0]))
    found = Rotation.from_quat(state.quat_wxyz, scalar_first=True).as_matrix()
    np.testing.assert_allclose(found, R, **near)
    np.testing.assert_allclose(state.velocity_in_base, v, **near)
    np.testing.assert_allclose(state.velocity_in_world, R @ v, **near)
    np.testing.assert_allclose(state.gravity, R.T @ DOWN / G, **near)
    np.testing.assert_allclose(state.angular_velocity, oracle.gyro - oracle.bg, **near)
    np.testing.assert_allclose(state.orientation_var, var[:3], **near)
    np.testing.assert_allclose(state.velocity_in_base_var, var[3:6], **near)
    np.testing.assert_allclose(state.velocity_in_world_var, np.diag(out @ P[:6, :6] @ out.T), **near)
    np.testing.assert_allclose(state.gravity_var, np.diag(tilt @ P[:3, :3] @ tilt.T), **near)
    lag = state.t - oracle.t
    of_rate = NOISE.gyro**2 / DT + (NOISE.angular_acceleration**2 + NOISE.gyro_walk**2) * lag
    np.testing.assert_allclose(state.angular_velocity_var, np.diag(oracle.kf.P)[6:9] + of_rate, **near)
    np.testing.assert_allclose(state.innovation, oracle.innovation, rtol=0, atol=1e-7)
    assert state.age == pytest.approx(lag, abs=1e-12)


@cache
def worked():
    """What two robots carry in the middle of their work, and what comes next."""
    stream, base = list(World(3, 2, 460).packets()), FloatingBase(NOISE, DT, 2, F)
    for packets in stream[:200]:
        base.step(*packets)
    return base.save(), stream[200:]


def settled():
    """An estimator of two robots in the middle of its work, and what comes next."""
    base, (carried, stream) = FloatingBase(NOISE, DT, 2, F), worked()
    base.restore(carried)
    return base, stream


def oracle_of(base):
    """Where the first robot is."""
    oracle = ByFilterpy(base.t_sample[0], *np.split(base.reading[0].copy(), 2))
    oracle.R, oracle.v = Rotation.from_quat(base.quat_wxyz[0], scalar_first=True), base.velocity[0].copy()
    oracle.bg, oracle.ba = np.split(base.bias[0].copy(), 2)
    return oracle


def test_the_errors_go_where_the_motion_takes_them():
    """F of the oracle, which the filter's is equal to, against finite differences of the motion."""
    oracle = oracle_of(settled()[0])
    gyro, force, h = oracle.gyro + 0.3, oracle.force - 1.0, 1e-6
    R, v, expected, _ = oracle.moved(DT, gyro, force, 0.0)
    found = np.zeros((12, 12))
    for i, e in enumerate(h * np.eye(12)):
        other = oracle_of(settled()[0])
        other.R = Rotation.from_rotvec(e[:3]) * oracle.R
        other.v, other.bg, other.ba = oracle.v + e[3:6], oracle.bg + e[6:9], oracle.ba + e[9:]
        R2, v2, _, _ = other.moved(DT, gyro, force, 0.0)
        found[:, i] = np.concatenate([(R2 * R.inv()).as_rotvec(), v2 - v, e[6:9], e[9:]]) / h
    np.testing.assert_allclose(found[:, :6], expected[:, :6], atol=1e-7)
    np.testing.assert_allclose(found[:, 6:], expected[:, 6:], atol=DT**2)


def test_the_discrete_model_is_van_loans_to_first_order():
    oracle = oracle_of(settled()[0])
    w, out = oracle.gyro - oracle.bg, oracle.R.as_matrix()
    A, L = np.zeros((12, 12)), np.zeros((12, 12))
    A[:3, 6:9], A[3:6, :3], A[3:6, 3:6] = -out, out.T @ cross(DOWN), -cross(w)
    A[3:6, 6:9], A[3:6, 9:] = -cross(oracle.v), -np.eye(3)
    L[:3, :3], L[3:6, :3], L[3:6, 3:6] = (
        out * NOISE.gyro,
        cross(oracle.v) * NOISE.gyro,
        np.eye(3) * NOISE.accelerometer,
    )
    L[6:9, 6:9], L[9:, 9:] = NOISE.gyro_walk * np.eye(3), NOISE.accelerometer_walk * np.eye(3)
    dt = 1e-3
    F_exact, Q_exact = van_loan_discretization(A, L, dt)
    _, _, F_found, Q_found = oracle.moved(dt, oracle.gyro, oracle.force, 0.0)
    np.testing.assert_allclose(F_found, F_exact, atol=20 * dt**2)
    np.testing.assert_allclose(Q_found, Q_exact, atol=0.03 * Q_exact.max())


def test_believes_what_its_model_says():
    """On robots that move as the model says, errors and innovations have the claimed size (NEES, NIS)."""
    robots, nees, nis = 200, [], []
    world = World(5, robots, 300)
    base = FloatingBase(NOISE, DT, robots, F)
    for t, imu, feet in world.packets():
        state, k = base.step(t, imu, feet), round(t / DT)
        if k < 100:
            continue
        R = Rotation.from_quat(state.quat_wxyz, scalar_first=True).as_matrix()
        up = (R @ world.R[k, :, 2, :, None])[..., 0]
        error = np.concatenate(
            [
                np.stack([up[:, 1], -up[:, 0]], axis=1),
                world.v[k] - state.velocity_in_base,
                world.gyro_bias[k] - base.bias[:, :3],
                world.force_bias[k] - base.bias[:, 3:],
            ],
            axis=1,
        )
        places = [0, 1, *range(3, 12)]
        P = base.P[:, places][:, :, places]
        nees.append((error * np.linalg.solve(P, error[..., None])[..., 0]).sum(axis=1).mean())
        nis.append((state.innovation[feet.stance] ** 2).sum(axis=1).mean())
    assert np.mean(nees) == pytest.approx(11.0, rel=0.1)
    assert np.mean(nis) == pytest.approx(3.0, rel=0.05)


def test_feet_and_gravity_say_nothing_about_yaw():
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


def test_yaw_is_less_and_less_known():
    base, stream = settled()
    before = base.P[:, 2, 2].copy()
    for packets in stream:
        state = base.step(*packets)
    assert (state.orientation_var[:, 2] > before + len(stream) * DT * NOISE.gyro**2).all()


def test_nothing_but_the_heading_depends_on_where_north_is():
    base, stream = settled()
    other, turn = settled()[0], Rotation.from_rotvec([0, 0, 2.0])
    other.quat_wxyz[:] = (turn * Rotation.from_quat(other.quat_wxyz, scalar_first=True)).as_quat(
        scalar_first=True
    )
    T = np.kron(np.diag([1, 0, 0, 0]), turn.as_matrix()) + np.diag([0] * 3 + [1] * 9)
    other.P[:] = T @ other.P @ T.T
    for packets in stream:
        state, turned = base.step(*packets), other.step(*packets)
    for name in ("velocity_in_base", "gravity", "angular_velocity", "velocity_in_base_var", "gravity_var"):
        np.testing.assert_allclose(getattr(turned, name), getattr(state, name), rtol=0, atol=1e-9)
    np.testing.assert_allclose(turned.velocity_in_world, turn.apply(state.velocity_in_world), atol=1e-9)


def test_robots_do_not_touch_each_other():
    """The row of 64 equals the row alone, bit for bit."""
    robots, some = 64, (0, 1, 30, 63)
    together, alone = FloatingBase(NOISE, DT, robots, F), {i: FloatingBase(NOISE, DT, 1, F) for i in some}
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
    other = FloatingBase(NOISE, DT, 2, F)
    assert set(base.carried) == {name for name in vars(base) if not name.startswith("_")}
    other.restore(saved)
    state = [other.step(*packets) for packets in stream][-1]
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(state, name), getattr(expected, name))


def test_a_look_at_now_leaves_the_belief_alone():
    base, stream = settled()
    other = settled()[0]
    t, imu, feet = stream[0]
    nothing = imu._replace(fresh=np.zeros(2, dtype=bool))
    early = base.step(t - 2 * DT, nothing, feet)
    np.testing.assert_array_equal(early.velocity_in_base, base.velocity)
    np.testing.assert_array_equal(early.orientation_var, base.P[:, range(3), range(3)])
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
    "infinite": lambda imu: imu._replace(accelerometer=imu.accelerometer + np.inf),
    "beyond any sensor": lambda imu: imu._replace(gyro=imu.gyro + 1.1 * RANGE),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_packet_is_a_packet_that_never_came(kind):
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
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(state, name), getattr(expected, name), err_msg=name)


def test_a_foot_of_nan_is_a_foot_in_the_air():
    base, stream = settled()
    clean = settled()[0]
    for t, imu, feet in stream:
        position, velocity = feet.position.copy(), feet.velocity.copy()
        position[0, 1, 2], velocity[1, 3, 0] = np.nan, np.inf
        stance = feet.stance.copy()
        stance[0, 1] = stance[1, 3] = False
        state = base.step(t, imu, Feet(stance=feet.stance, position=position, velocity=velocity))
        expected = clean.step(t, imu, feet._replace(stance=stance))
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(state, name), getattr(expected, name), err_msg=name)


def test_a_foot_that_slips_grossly_changes_nothing():
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


def test_the_gate_refuses_one_good_foot_of_a_thousand():
    assert stats.chi2.sf(GATE, 3) == pytest.approx(1e-3, rel=0.01)


def test_silence_widens_everything_and_one_packet_mends_it():
    base, stream = settled()
    widths = []
    for tick, (t, imu, feet) in enumerate(stream[:60]):
        quiet = 10 <= tick < 50
        state = base.step(t, imu._replace(fresh=imu.fresh & (not quiet)), feet)
        parts = [getattr(state, name) for name in FIELDS if name.endswith("_var")]
        widths.append(np.concatenate([*parts, state.age[:, None]], axis=1))
    widths = np.array(widths)
    assert (np.diff(widths[9:50], axis=0)[..., :-1] > 0).mean() > 0.95
    assert (widths[49] > 2 * widths[9])[:, 3:].all()
    assert state.age == pytest.approx(0.0, abs=1e-12)
    assert (widths[50][:, 3:6] < 0.5 * widths[49][:, 3:6]).all()


def test_a_gap_is_integrated():
    """A known turn and push while nobody listened: both ends of the gap tell."""
    base = FloatingBase(NOISE, DT, 1, F)
    feet = Feet(
        stance=np.zeros((1, F), dtype=bool), position=np.zeros((1, F, 3)), velocity=np.zeros((1, F, 3))
    )
    yes, up = np.ones(1, dtype=bool), np.array([[0.0, 0.0, G]])
    turning = np.array([[0.0, 0.0, 0.5]])
    base.step(0.0, Imu(np.zeros(1), yes, turning, up), feet)
    state = base.step(0.1, Imu(np.full(1, 0.1), yes, turning, up + np.eye(1, 3)), feet)
    angle = Rotation.from_quat(state.quat_wxyz[0], scalar_first=True).as_rotvec()
    np.testing.assert_allclose(angle, [0, 0, 0.05], atol=1e-12)
    np.testing.assert_allclose(state.velocity_in_base, [[0.05, 0, 0]], atol=1e-12)


@pytest.mark.parametrize("which", ["gyro", "accelerometer"])
def test_a_sensor_that_repeats_itself_is_stuck_and_left_out(which):
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


def test_a_filter_whose_feet_all_contradict_it_has_diverged():
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
def test_a_filter_that_knows_too_little_has_diverged(errors, std_max):
    """Of tilt, both ways together, or of speed; yaw, which nothing tells, is not asked."""
    for share in (0.99, 1.01):
        base, stream = settled()
        t, imu, feet = stream[0]
        base.P[0, errors, :] = base.P[0, :, errors] = 0.0
        base.P[0, errors, errors] = share * min(std_max, 1e3) ** 2 / len(errors)
        state = base.step(t - DT, imu._replace(fresh=np.zeros(2, dtype=bool)), feet)
        assert state.diverged.tolist() == [share > 1 and std_max < 1e3, False]


def test_a_filter_in_silence_says_when_it_has_lost_the_base():
    base, stream = settled()
    t, imu, feet = stream[0]
    silent = imu._replace(fresh=np.zeros(2, dtype=bool))
    told = [base.step(t + late, silent, feet).diverged.all() for late in (0.0, 0.1, 1.0, 3.0)]
    assert told == [False, False, True, True]


@pytest.mark.parametrize("name", ["P", "velocity", "bias", "quat_wxyz"])
def test_a_belief_that_is_no_number_says_so_until_it_is_reset(name):
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
def test_garbage_neither_raises_nor_reaches_the_neighbour(seed):
    """In packets, and in the belief itself; where the estimate is no number, it says so."""
    rng, base, clean = (
        np.random.default_rng(seed),
        FloatingBase(NOISE, DT, 2, F),
        FloatingBase(NOISE, DT, 1, F),
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
            assert state.diverged[0] or not base.seeded[0] or np.isfinite(getattr(state, name)[0]).all()


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


@settings(max_examples=50, deadline=None, derandomize=True)
@given(up=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda up: np.linalg.norm(up) > 0.1))
def test_gravity_seeds_the_tilt_and_nothing_else(up):
    up = np.array(up) / np.linalg.norm(up)
    base = FloatingBase(NOISE, DT, 1, F)
    feet = Feet(stance=np.ones((1, F), dtype=bool), position=np.ones((1, F, 3)), velocity=np.ones((1, F, 3)))
    state = base.step(0.0, Imu(np.zeros(1), np.ones(1, dtype=bool), np.ones((1, 3)), G * up[None]), feet)
    np.testing.assert_allclose(state.gravity[0], -up, atol=1e-12)
    ahead = Rotation.from_quat(state.quat_wxyz[0], scalar_first=True).apply([1.0, 0.0, 0.0])
    assert ahead[1] == pytest.approx(0.0, abs=1e-12)
    assert ahead[0] > -1e-12
    np.testing.assert_array_equal(state.velocity_in_base, 0.0)
    assert state.orientation_var[0, 2] == 0.0


def test_nobody_is_seeded_in_free_fall_or_before_time_began():
    base = FloatingBase(NOISE, DT, 4, F)
    feet = Feet(np.zeros((4, F), dtype=bool), *np.zeros((2, 4, F, 3)))
    force = np.outer([0.1, 2.0, 1.0, 1.0], [0.0, 0.0, G])
    t = np.array([0.0, 0.0, 0.0, -np.inf])
    state = base.step(0.0, Imu(t, np.ones(4, dtype=bool), np.zeros((4, 3)), force), feet)
    assert np.isinf(state.age).tolist() == [True, True, False, True]
    assert not base.seeded[3]
    assert not state.diverged.any()


@settings(max_examples=8, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), loss=st.floats(0, 0.95))
def test_covariance_stays_that_of_something(seed, loss):
    base = FloatingBase(NOISE, DT, 4, F)
    for t, imu, feet in World(seed, 4, 250).packets(loss, lag_max=2, slipping=0.1):
        state = base.step(t, imu, feet)
    np.testing.assert_array_equal(base.P, base.P.swapaxes(1, 2))
    assert (np.linalg.eigvalsh(base.P) > -1e-12).all()
    np.testing.assert_allclose(np.linalg.norm(state.quat_wxyz, axis=1), 1.0, atol=1e-14)
    assert all(np.isfinite(getattr(state, name)).all() for name in FIELDS)


def test_more_noise_is_less_certainty():
    stream = list(World(9, 2, 150).packets())
    quiet, loud = FloatingBase(NOISE, DT, 2, F), FloatingBase(replace(NOISE, slip=2 * NOISE.slip), DT, 2, F)
    for packets in stream:
        states = quiet.step(*packets), loud.step(*packets)
    assert (states[1].velocity_in_base_var > states[0].velocity_in_base_var).all()
