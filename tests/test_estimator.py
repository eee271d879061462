import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from test_spec import SPEC

from deploy.estimator import SPEED_STD, Estimator
from deploy.state import Sample

N, DT = SPEC.n, SPEC.dt
NOISE = np.sqrt(SPEC.encoder.noise_rad**2 + SPEC.encoder.resolution_rad**2 / 12)


def packets(rng, robots, ticks, loss, lag_max=3):
    """What an unkind bus delivers: each robot its own delay, losses, and old packets that come again."""
    lag = rng.integers(0, lag_max + 1, robots)
    t, q = np.zeros(robots), np.zeros((robots, N))
    for tick in range(ticks):
        fresh = rng.random(robots) >= loss
        repeat = rng.random(robots) < 0.05
        t = np.where(fresh & ~repeat, (tick - lag) * DT, t)
        noisy = np.sin(tick * DT + np.arange(N)) + rng.normal(0, NOISE, (robots, N))
        q = np.where((fresh & ~repeat)[:, None], noisy, q)
        yield tick * DT, sample(t, fresh, q)


def sample(t, fresh, q):
    robots = len(q)
    return Sample(
        t=np.array(t, dtype=float),
        fresh=np.array(fresh, dtype=bool),
        q=np.array(q, dtype=float),
        current=np.zeros((robots, N)),
        temperature=np.full((robots, N), 30.0),
    )


class ByFilterpy:
    """The oracle: one textbook filter for each joint of each robot."""

    def __init__(self, robots):
        self.filters = [[None] * N for _ in range(robots)]
        self.t = np.full(robots, np.nan)
        self.innovation = np.zeros((robots, N))

    def step(self, t, s):
        for robot in np.flatnonzero(s.fresh):
            if not np.isnan(self.t[robot]) and s.t[robot] <= self.t[robot]:
                continue
            for joint in range(N):
                self._fuse(robot, joint, s.t[robot], s.q[robot, joint])
            self.t[robot] = s.t[robot]
        q, qd, var = np.zeros((3, len(self.t), N))
        for robot, row in enumerate(self.filters):
            for joint, kf in enumerate(row):
                if kf is not None:
                    f, noise = _model(t - self.t[robot])
                    q[robot, joint], qd[robot, joint] = (f @ kf.x)[:, 0]
                    var[robot, joint] = (f @ kf.P @ f.T + noise)[0, 0]
        return q, qd, var

    def _fuse(self, robot, joint, t, z):
        kf = self.filters[robot][joint]
        if kf is None:
            kf = self.filters[robot][joint] = KalmanFilter(dim_x=2, dim_z=1)
            kf.x = np.array([[z], [0.0]])
            kf.P = np.diag([NOISE**2, SPEED_STD**2])
            kf.H, kf.R = np.array([[1.0, 0.0]]), np.array([[NOISE**2]])
            return
        kf.F, kf.Q = _model(t - self.t[robot])
        kf.predict()
        kf.update(z)
        self.innovation[robot, joint] = kf.y[0, 0] / np.sqrt(kf.S[0, 0])


def _model(dt):
    noise = Q_continuous_white_noise(2, dt, SPEC.encoder.acceleration_density) if dt > 0 else np.zeros((2, 2))
    return np.array([[1.0, dt], [0.0, 1.0]]), noise


@pytest.mark.parametrize(("seed", "loss"), [(0, 0.0), (1, 0.2), (2, 0.7)])
def test_equals_filterpy(seed, loss):
    robots, rng = 3, np.random.default_rng(seed)
    estimator, oracle = Estimator(SPEC, robots), ByFilterpy(robots)
    for t, s in packets(rng, robots, 300, loss):
        state, (q, qd, var) = estimator.step(t, s), oracle.step(t, s)
        seeded = ~np.isnan(oracle.t)
        np.testing.assert_allclose(state.q[seeded], q[seeded], rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.qd[seeded], qd[seeded], rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.q_var[seeded], var[seeded], rtol=1e-8, atol=1e-15)
        np.testing.assert_allclose(state.innovation, oracle.innovation, rtol=0, atol=1e-8)
        np.testing.assert_allclose(state.age[seeded], (t - oracle.t)[seeded], rtol=0, atol=1e-12)
        assert np.isinf(state.age[~seeded]).all()


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), loss=st.floats(0, 0.95))
def test_covariance_stays_positive_and_state_finite(seed, loss):
    estimator = Estimator(SPEC, 4)
    for t, s in packets(np.random.default_rng(seed), 4, 250, loss):
        state = estimator.step(t, s)
        p00, p01, p11 = (p[estimator.seeded] for p in (estimator.p00, estimator.p01, estimator.p11))
        assert (p00 > 0).all()
        assert (p11 > 0).all()
        assert (p00 * p11 > p01**2).all()
        assert np.isfinite(state.q).all()
        assert (state.q_var >= 0).all()


def test_believes_what_its_model_says():
    """On joints that really move as the model says, errors and innovations have the claimed size (NEES, NIS)."""
    robots, rng, density = 200, np.random.default_rng(5), SPEC.encoder.acceleration_density
    estimator = Estimator(SPEC, robots)
    root = np.linalg.cholesky(Q_continuous_white_noise(2, DT, density))
    x, errors, innovations = np.zeros((2, robots, N)), [], []
    for tick in range(120):
        z = x[0] + rng.normal(0, NOISE, (robots, N))
        t = np.full(robots, tick * DT)
        state = estimator.step(tick * DT, sample(t, np.ones(robots), z))
        if tick >= 60:
            errors.append(((state.q - x[0]) ** 2 / state.q_var).mean())
            innovations.append((state.innovation**2).mean())
        x[0] += x[1] * DT
        x += np.einsum("ij,jrn->irn", root, rng.standard_normal((2, robots, N)))
    assert np.mean(errors) == pytest.approx(1.0, abs=0.05)
    assert np.mean(innovations) == pytest.approx(1.0, abs=0.05)


def test_first_packet_seeds_at_rest():
    estimator, rng = Estimator(SPEC, 2), np.random.default_rng(0)
    q = rng.normal(size=(2, N))
    state = estimator.step(0.5, sample([0.49, 0.49], [True, False], q))
    np.testing.assert_array_equal(state.q[0], q[0])
    np.testing.assert_array_equal(state.qd, 0.0)
    assert state.age[0] == pytest.approx(0.01)
    assert state.age[1] == np.inf


def test_coasts_on_its_speed_when_packets_stay_away():
    estimator = Estimator(SPEC, 1)
    for tick in range(200):
        state = estimator.step(tick * DT, sample([tick * DT], [True], np.full((1, N), 0.4 * tick * DT)))
    np.testing.assert_allclose(state.qd, 0.4, atol=1e-6)
    coasting = estimator.step(2.0, sample([199 * DT], [False], np.zeros((1, N))))
    np.testing.assert_allclose(coasting.q, 0.8, atol=1e-4)
    assert coasting.age[0] == pytest.approx(2.0 - 199 * DT)
    assert (coasting.q_var > state.q_var).all()


def test_robots_do_not_touch_each_other():
    robots = 5
    together, alone = Estimator(SPEC, robots), [Estimator(SPEC, 1) for _ in range(robots)]
    for t, s in packets(np.random.default_rng(3), robots, 200, 0.3):
        state = together.step(t, s)
        for i, estimator in enumerate(alone):
            one = slice(i, i + 1)
            single = estimator.step(t, sample(s.t[one], s.fresh[one], s.q[one]))
            for name in ("q", "qd", "q_var", "age", "innovation"):
                np.testing.assert_array_equal(getattr(single, name)[0], getattr(state, name)[i])


def test_a_packet_of_nan_is_a_packet_that_never_came():
    estimator, clean = Estimator(SPEC, 3), Estimator(SPEC, 3)
    for tick, (t, s) in enumerate(packets(np.random.default_rng(4), 3, 100, 0.1)):
        bad, lost = (sample(s.t.copy(), s.fresh.copy(), s.q.copy()) for _ in range(2))
        if 50 <= tick < 60:
            bad.q[1, 2], bad.fresh[1], lost.fresh[1] = np.nan, True, False
        state, expected = estimator.step(t, bad), clean.step(t, lost)
    for name in ("q", "qd", "q_var", "age", "innovation"):
        np.testing.assert_array_equal(getattr(state, name), getattr(expected, name))


def test_reset_of_a_subset():
    estimator, stream = Estimator(SPEC, 3), list(packets(np.random.default_rng(6), 3, 210, 0.0, lag_max=0))
    for t, s in stream[:200]:
        before = estimator.step(t, s)
    estimator.reset(np.array([False, True, False]))
    t = stream[200][0]
    after = estimator.step(t, sample([0, t, 0], [False, False, False], np.full((3, N), 2.0)))
    assert np.isinf(after.age).tolist() == [False, True, False]
    seeded = estimator.step(t, sample([0, t, 0], [False, True, False], np.full((3, N), 2.0)))
    np.testing.assert_array_equal(seeded.q[1], 2.0)
    np.testing.assert_array_equal(seeded.qd[1], 0.0)
    np.testing.assert_array_equal(seeded.innovation[1], 0.0)
    np.testing.assert_array_equal(seeded.qd[[0, 2]], before.qd[[0, 2]])


def test_saved_and_restored_goes_on_bit_for_bit():
    estimator, other = Estimator(SPEC, 4), Estimator(SPEC, 4)
    stream = list(packets(np.random.default_rng(7), 4, 250, 0.2))
    for t, s in stream[:120]:
        estimator.step(t, s)
    saved = estimator.save()
    for t, s in stream[120:]:
        expected = estimator.step(t, s)
    other.restore(saved)
    for t, s in stream[120:]:
        state = other.step(t, s)
    for name in ("q", "qd", "q_var", "age", "innovation"):
        np.testing.assert_array_equal(getattr(state, name), getattr(expected, name))


def test_saved_arrays_are_copies():
    estimator = Estimator(SPEC, 1)
    saved = estimator.save()
    for t, s in packets(np.random.default_rng(8), 1, 20, 0.0):
        estimator.step(t, s)
    np.testing.assert_array_equal(saved["q"], 0.0)
    assert not saved["seeded"].any()


def test_an_older_packet_than_the_last_is_left_out():
    estimator = Estimator(SPEC, 1)
    for tick in range(10):
        state = estimator.step(tick * DT, sample([tick * DT], [True], np.full((1, N), 0.1)))
    late = estimator.step(9 * DT, sample([5 * DT], [True], np.full((1, N), 3.0)))
    np.testing.assert_array_equal(late.q, state.q)


def test_a_packet_from_the_future_is_left_out():
    """A clock that runs wrong must make the state stale, not fresh forever."""
    estimator = Estimator(SPEC, 1)
    for tick in range(10):
        estimator.step(tick * DT, sample([tick * DT], [True], np.full((1, N), 0.1)))
    for tick in range(10, 60):
        state = estimator.step(tick * DT, sample([tick * DT + 100.0], [True], np.full((1, N), 0.1)))
    assert state.age[0] == pytest.approx(50 * DT)
    np.testing.assert_allclose(state.q, 0.1, atol=1e-3)
