"""The filter of a floating base against filterpy's, and its model against what it should be a model of."""

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise, van_loan_discretization
from filterpy.kalman import ExtendedKalmanFilter
from scipy.spatial.transform import Rotation

from deploy.estimation.floating_base.base_faults import GATE
from deploy.estimation.floating_base.base_filter import INITIAL_ACCELERATION_STD, INITIAL_SPEED_STD
from deploy.estimation.floating_base.base_model import G
from support.deploy.floating_bases import DOWN, DT, NOISE, F, World, base_filter, cross, one, settled


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
        level = np.diag([1.0, 1.0, 0.0]) * INITIAL_ACCELERATION_STD**2 / G**2
        P = np.zeros((12, 12))
        P[:3, :3] = tilt_by_bias @ bias @ tilt_by_bias.T + level
        P[:3, 9:], P[9:, :3], P[9:, 9:] = tilt_by_bias @ bias, bias @ tilt_by_bias.T, bias
        P[3:6, 3:6] = INITIAL_SPEED_STD**2 * np.eye(3)
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
        """R and v, carried to now."""
        R, v, *_ = self.moved(t - self.t, self.gyro, self.force, 0.0)
        return R.as_matrix(), v


@pytest.mark.parametrize(("seed", "loss", "slipping"), [(0, 0.0, 0.0), (1, 0.2, 0.05), (2, 0.6, 0.2)])
@pytest.mark.slow
def test_equals_filterpy(seed, loss, slipping):
    robots = 2
    base, oracles, refused = base_filter(robots), [None] * robots, 0
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
    R, v = oracle.now(state.t)
    found = Rotation.from_quat(state.quat_wxyz, scalar_first=True).as_matrix()
    np.testing.assert_allclose(found, R, **near)
    np.testing.assert_allclose(state.velocity_in_base, v, **near)
    np.testing.assert_allclose(state.velocity_in_world, R @ v, **near)
    np.testing.assert_allclose(state.gravity, R.T @ DOWN / G, **near)
    np.testing.assert_allclose(state.angular_velocity, oracle.gyro - oracle.bg, **near)
    np.testing.assert_allclose(state.innovation, oracle.innovation, rtol=0, atol=1e-7)
    assert state.age == pytest.approx(state.t - oracle.t, abs=1e-12)


def oracle_of(base):
    """Where the first robot is."""
    oracle = ByFilterpy(base.t_sample[0], *np.split(base.reading[0].copy(), 2))
    oracle.R, oracle.v = Rotation.from_quat(base.quat_wxyz[0], scalar_first=True), base.velocity[0].copy()
    oracle.bg, oracle.ba = np.split(base.bias[0].copy(), 2)
    return oracle


def test_error_propagation_equals_finite_differences():
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


def test_discrete_process_noise_equals_van_loan_to_first_order():
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


def test_consistent_with_its_own_model():
    """On robots that move as the model says, errors and innovations have the claimed size (NEES, NIS)."""
    robots, nees, nis = 200, [], []
    world = World(5, robots, 300)
    base = base_filter(robots)
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
