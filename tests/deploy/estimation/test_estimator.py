import os
import subprocess
import sys

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.estimation.estimator import Estimator
from deploy.estimation.fault_detection import STUCK_SHARE
from deploy.estimation.joint_filter import CONFIRMED_S, GATE, INITIAL_SPEED_STD, NIS_S
from deploy.estimation.setpoint_history import HISTORY_S
from deploy.reasons import Reason
from deploy.state import Packet, Setpoint
from robots.models.nominal_model import torque_max
from robots.motors.gains import Gains
from robots.spec import load_robot
from robots.tables import Rates
from support.arm6 import SPEC, copy_of_arm
from support.deploy.estimate_digest import estimate_digest
from support.deploy.estimators import DENSITY, DT, ENCODER, NOISE, N, begun, packets, sample, sent, still

PLAY = SPEC.joint_array("play")
UNSEEN = ENCODER.bias**2 / 3 + PLAY**2 / 12
SPEED_NOISE = 0.005
CONFIRMED, NIS_SAMPLES = round(CONFIRMED_S / DT), round(NIS_S / DT)
SOFT = Gains(kp=np.full(N, 100.0), kd=np.full(N, 5.0))
NAMES = ("q", "qd", "q_var", "age", "nis", "fault")


class ByFilterpy:
    """The oracle: one textbook filter for each joint of each robot, its setpoint's motion as a known input."""

    def __init__(self, robots):
        self.filters = [[None] * N for _ in range(robots)]
        self.t = np.full((robots, N), np.nan)
        self.nis, self.many = np.zeros((2, robots, N))

    def step(self, tick, s):
        packet, robots = s["encoder"], len(self.t)
        for robot in np.flatnonzero(packet.fresh):
            seeded = self.filters[robot][0] is not None
            if seeded or np.isfinite(packet.value[robot]).all():
                self._hear(robot, packet.t[robot], packet.value[robot])
        q, qd, var = np.zeros((3, robots, N))
        for robot, row in enumerate(self.filters):
            for joint, kf in enumerate(row):
                if kf is not None:
                    f, noise = _model(tick * DT - self.t[robot, joint], joint)
                    u = _input(robot, joint, self.t[robot, joint], tick * DT, robots)
                    q[robot, joint], qd[robot, joint] = (f @ kf.x + u)[:, 0]
                    var[robot, joint] = (f @ kf.P @ f.T + noise)[0, 0] + UNSEEN[joint]
        return q, qd, var

    def _hear(self, robot, t, value):
        for joint in np.flatnonzero(np.isfinite(value)):
            if not t <= self.t[robot, joint]:
                self._fuse(robot, joint, t, value[joint])

    def _fuse(self, robot, joint, t, z):
        kf = self.filters[robot][joint]
        if kf is None:
            kf = self.filters[robot][joint] = KalmanFilter(dim_x=2, dim_z=1)
            speed = sent(round(t / DT), len(self.t)).qd[robot, joint]
            kf.x = np.array([[z], [speed]])
            kf.P = np.diag([NOISE**2, INITIAL_SPEED_STD**2])
            kf.H, kf.R, self.nis[robot, joint] = np.array([[1.0, 0.0]]), np.array([[NOISE**2]]), 1.0
        else:
            kf.F, kf.Q = _model(t - self.t[robot, joint], joint)
            kf.predict(u=_input(robot, joint, self.t[robot, joint], t, len(self.t)), B=np.eye(2))
            kf.update(z)
            self.nis[robot, joint] += (kf.y[0, 0] ** 2 / kf.S[0, 0] - self.nis[robot, joint]) / NIS_SAMPLES
        self.t[robot, joint] = t
        self.many[robot, joint] += 1


def _input(robot, joint, old, new, robots):
    """What the setpoint did between two times beyond going on at its speed."""
    r = [
        np.array([[part[robot, joint]] for part in sent(round(time / DT), robots)[:2]]) for time in (old, new)
    ]
    return r[1] - _model(new - old)[0] @ r[0]


def _model(dt, joint=0):
    noise = Q_continuous_white_noise(2, dt, DENSITY[joint]) if dt > 0 else np.zeros((2, 2))
    return np.array([[1.0, dt], [0.0, 1.0]]), noise


@pytest.mark.parametrize(("seed", "loss"), [(0, 0.0), (1, 0.2), (2, 0.7)])
@pytest.mark.slow
def test_equals_filterpy(seed, loss):
    robots, rng = 3, np.random.default_rng(seed)
    estimator, oracle = begun(robots), ByFilterpy(robots)
    for tick, s, setpoint in packets(rng, robots, 300, loss):
        state, (q, qd, var) = estimator.step(tick * DT, s, setpoint), oracle.step(tick, s)
        seeded = ~np.isnan(oracle.t).any(axis=1)
        np.testing.assert_allclose(state.q[seeded], q[seeded], rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.qd[seeded], qd[seeded], rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.q_var[seeded], var[seeded], rtol=1e-8, atol=1e-15)
        np.testing.assert_allclose(state.nis, oracle.nis, rtol=0, atol=1e-7)
        age = (tick * DT - oracle.t).max(axis=1)
        age[(oracle.many < CONFIRMED).any(axis=1)] = np.inf
        np.testing.assert_allclose(state.age, age, rtol=0, atol=1e-12)
    assert seeded.all()
    assert not state.fault.any()


@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), loss=st.floats(0, 0.95))
@pytest.mark.slow
def test_covariance_stays_positive_and_state_finite(seed, loss):
    estimator = begun(4)
    for tick, s, setpoint in packets(np.random.default_rng(seed), 4, 250, loss):
        state = estimator.step(tick * DT, s, setpoint)
        joints = estimator.joints
        p00, p01, p11 = (p[joints.initialized] for p in (joints.p00, joints.p01, joints.p11))
        assert (p00 > 0).all()
        assert (p11 > 0).all()
        assert (p00 * p11 > p01**2).all()
        assert np.isfinite(state.q).all()
        assert (state.q_var >= 0).all()


def test_consistent_with_its_own_model():
    """On joints that really stray as the model says, errors and innovations have the claimed size (NEES, NIS)."""
    robots, rng = 200, np.random.default_rng(5)
    estimator = Estimator(SPEC, robots)
    root = np.linalg.cholesky([Q_continuous_white_noise(2, DT, density) for density in DENSITY])
    x, errors = np.zeros((2, robots, N)), []
    bias = rng.uniform(-ENCODER.bias, ENCODER.bias, (robots, N))
    lies = rng.uniform(-PLAY / 2, PLAY / 2, (robots, N))  # the link, in its play
    for tick in range(120):
        setpoint = sent(tick, robots)
        z = setpoint.q + x[0] + bias + rng.normal(0, NOISE, (robots, N))
        state = estimator.step(tick * DT, sample(np.full(robots, tick * DT), np.ones(robots), z), setpoint)
        if tick >= 60:
            errors.append(((state.q - setpoint.q - x[0] - lies) ** 2 / state.q_var).mean())
        x[0] += x[1] * DT
        x += np.einsum("nij,jrn->irn", root, rng.standard_normal((2, robots, N)))
    assert np.mean(errors) == pytest.approx(1.0, abs=0.05)
    assert state.nis.mean() == pytest.approx(1.0, abs=0.05)


def test_first_packet_initializes_with_the_sent_velocity():
    estimator, rng = Estimator(SPEC, 2), np.random.default_rng(0)
    q = rng.normal(size=(2, N))
    for tick in range(101):
        state = estimator.step(tick * DT, sample([0.49, 0.49], [tick == 100, False], q), still(2, 0.2))
    np.testing.assert_allclose(state.q[0], q[0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(state.qd, 0.0)
    np.testing.assert_array_equal(state.age, np.inf)


@pytest.mark.parametrize("ahead", [0.3, 0.6, 1.0])
def test_packet_stamped_slightly_ahead_is_compared_with_the_current_setpoint(ahead):
    estimator, speed = Estimator(SPEC, 1), 0.8
    for tick in range(200):
        t, now = (tick + ahead) * DT, still(1, speed * tick * DT)._replace(qd=np.full((1, N), speed))
        state = estimator.step(tick * DT, sample([t], [True], np.full((1, N), speed * t)), now)
    np.testing.assert_allclose(state.q, speed * 199 * DT, rtol=0, atol=1e-9)
    assert not state.fault.any()


def test_prediction_follows_the_setpoint_without_packets():
    """With the deviation that it had, growing less and less sure."""
    estimator = Estimator(SPEC, 1)
    for tick in range(200):
        state = estimator.step(tick * DT, sample([tick * DT], [True], sent(tick, 1).q + 0.01), sent(tick, 1))
    np.testing.assert_allclose(state.qd, sent(199, 1).qd, rtol=0, atol=1e-6)
    for tick in range(200, 220):
        coasting = estimator.step(tick * DT, sample([199 * DT], [False], np.zeros((1, N))), sent(tick, 1))
    np.testing.assert_allclose(coasting.q, sent(219, 1).q + 0.01, rtol=0, atol=1e-6)
    assert coasting.age[0] == pytest.approx(20 * DT)
    assert (coasting.q_var > 2 * state.q_var).all()


def test_packets_between_ticks_are_compared_with_interpolated_setpoints():
    estimator, speed = Estimator(SPEC, 1), 0.8
    for tick in range(200):
        t, now = (tick - 0.4) * DT, still(1, speed * tick * DT)._replace(qd=np.full((1, N), speed))
        state = estimator.step(tick * DT, sample([t], [True], np.full((1, N), speed * t)), now)
    np.testing.assert_allclose(state.q, speed * 199 * DT, rtol=0, atol=1e-9)


@pytest.fixture(scope="module")
def with_speed(tmp_path_factory):
    """The arm with drives that measure their speed."""
    table = f"""
[sensors.velocity]
unit = "rad/s"
rate_hz = 200
resolution = 0.001
range = 10.0
noise = {SPEED_NOISE}
bias = 0.0
drift = 0.0
drift_per_k = 0.0
delay_s = 0.008
loss = 0.0
source = "a test"

[sensors.current]"""
    folder = copy_of_arm(tmp_path_factory.mktemp("arm"), toml=[(r"\[sensors\.current\]", table)])
    return load_robot(folder)


def test_measured_speed_equals_filterpys_second_update(with_speed):
    """Angle and speed in one packet: one textbook filter that is told both, one after the other."""
    estimator, rng = Estimator(with_speed, 1), np.random.default_rng(12)
    kf = [KalmanFilter(dim_x=2, dim_z=1) for _ in range(N)]
    r_speed = with_speed.sensors["velocity"].variance
    for tick in range(250):
        heard, lost = rng.random() > 0.3, rng.random() < 0.3
        z, w = rng.normal(0, NOISE, (1, N)), rng.normal(0, SPEED_NOISE, (1, N))
        packets = sample([tick * DT], [heard or not tick], z)
        packets["velocity"] = packets["encoder"]._replace(
            value=w, fresh=np.array([(heard and not lost) or not tick])
        )
        state = estimator.step(tick * DT, packets, still(1))
        for joint in range(N):
            if tick == 0:
                kf[joint].x, kf[joint].P = (
                    np.array([[z[0, joint]], [0.0]]),
                    np.diag([NOISE**2, INITIAL_SPEED_STD**2]),
                )
            else:
                kf[joint].F, kf[joint].Q = _model(DT, joint)
                kf[joint].predict()
            if heard and tick:
                kf[joint].update(z[0, joint], R=NOISE**2, H=np.array([[1.0, 0.0]]))
            if (heard and not lost) or not tick:
                kf[joint].update(w[0, joint], R=r_speed, H=np.array([[0.0, 1.0]]))
        np.testing.assert_allclose(state.q[0], [k.x[0, 0] for k in kf], rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.qd[0], [k.x[1, 0] for k in kf], rtol=0, atol=1e-9)
        expected = [k.P[0, 0] for k in kf] + UNSEEN
        np.testing.assert_allclose(state.q_var[0], expected, rtol=1e-8)


def test_measured_velocity_improves_the_estimate_and_a_late_one_does_no_harm(with_speed):
    errors = {}
    for how in ("none", "with", "late"):
        rng, estimator, found = np.random.default_rng(13), Estimator(with_speed, 40), []
        for tick in range(200):
            setpoint = sent(tick, 40)
            packets = sample([tick * DT] * 40, [True] * 40, setpoint.q + rng.normal(0, NOISE, (40, N)))
            late = 2 if how == "late" else 0
            speed = sent(tick - late, 40).qd + rng.normal(0, SPEED_NOISE, (40, N))
            stamp = np.full(40, (tick - late) * DT)
            if how == "none":
                speed[:] = np.nan
            packets["velocity"] = Packet(t=stamp, fresh=np.ones(40, dtype=bool), value=speed)
            state = estimator.step(tick * DT, packets, setpoint)
            found.append(state.qd - setpoint.qd)
        errors[how] = np.sqrt(np.mean(np.square(found[50:])))
    assert errors["with"] < 0.7 * errors["none"]
    assert errors["late"] < 0.8 * errors["none"]


def test_robots_do_not_touch_each_other():
    robots = 5
    together, alone = begun(robots), [begun(robots, slice(i, i + 1)) for i in range(robots)]
    for tick, s, setpoint in packets(np.random.default_rng(3), robots, 200, 0.3):
        state = together.step(tick * DT, s, setpoint)
        for i, estimator in enumerate(alone):
            one, p = slice(i, i + 1), s["encoder"]
            mine = Setpoint(*(part[one] for part in setpoint[:3]))
            single = estimator.step(tick * DT, sample(p.t[one], p.fresh[one], p.value[one]), mine)
            for name in NAMES:
                np.testing.assert_array_equal(getattr(single, name)[0], getattr(state, name)[i])


def test_reset_of_a_subset():
    estimator, q = Estimator(SPEC, 3), np.full((3, N), 2.0)
    for tick in range(200):
        before = estimator.step(tick * DT, sample([tick * DT] * 3, [True] * 3, np.zeros((3, N))), still(3))
    estimator.reset(np.array([False, True, False]), still(3))
    t = 200 * DT
    after = estimator.step(t, sample([0, t, 0], [False, False, False], q), still(3))
    assert np.isinf(after.age).tolist() == [False, True, False]
    seeded = estimator.step(t, sample([0, t, 0], [False, True, False], q), still(3))
    np.testing.assert_array_equal(seeded.q[1], 2.0)
    np.testing.assert_array_equal(seeded.qd[1], 0.0)
    np.testing.assert_array_equal(seeded.nis[1], 1.0)
    np.testing.assert_array_equal(seeded.qd[[0, 2]], before.qd[[0, 2]])


def test_changed_setpoint_moves_no_estimate_at_rest():
    """Arming sends a robot to where it stands: what is believed of it stays."""
    estimator, q = Estimator(SPEC, 2), np.full((2, N), 0.7)
    for tick in range(100):
        before = estimator.step(tick * DT, sample([tick * DT] * 2, [True] * 2, q), still(2))
    there = still(2, before.q)
    estimator.follow(np.array([True, False]), still(2), there)
    now = still(2)
    now.q[0] = there.q[0]
    after = estimator.step(100 * DT, sample([99 * DT] * 2, [True] * 2, q), now)
    np.testing.assert_allclose(after.q, 0.7, rtol=0, atol=1e-12)
    for tick in range(101, 140):
        after = estimator.step(tick * DT, sample([(tick - 2) * DT] * 2, [True] * 2, q), now)
    np.testing.assert_allclose(after.q, 0.7, rtol=0, atol=1e-12)
    assert not after.fault.any()


def test_saved_and_restored_goes_on_bit_for_bit():
    estimator, other = Estimator(SPEC, 4), Estimator(SPEC, 4)
    stream = list(packets(np.random.default_rng(7), 4, 250, 0.2))
    for tick, s, setpoint in stream[:120]:
        estimator.step(tick * DT, s, setpoint)
    saved = estimator.save()
    for tick, s, setpoint in stream[120:]:
        expected = estimator.step(tick * DT, s, setpoint)
    other.restore(saved)
    for tick, s, setpoint in stream[120:]:
        state = other.step(tick * DT, s, setpoint)
    for name in NAMES:
        np.testing.assert_array_equal(getattr(state, name), getattr(expected, name))


def test_saved_arrays_are_copies():
    estimator = Estimator(SPEC, 1)
    saved = estimator.save()
    for tick, s, setpoint in packets(np.random.default_rng(8), 1, 20, 0.0):
        estimator.step(tick * DT, s, setpoint)
    np.testing.assert_array_equal(saved["joints.e"], 0.0)
    assert not saved["joints.initialized"].any()


@pytest.mark.parametrize("taken", [5, 9 - round(HISTORY_S / DT)])
def test_packet_older_than_the_last_is_ignored(taken):
    estimator = Estimator(SPEC, 1)
    for tick in range(10):
        state = estimator.step(tick * DT, sample([tick * DT], [True], np.full((1, N), 0.1)), still(1))
    late = estimator.step(9 * DT, sample([taken * DT], [True], np.full((1, N), 3.0)), still(1))
    np.testing.assert_array_equal(late.q, state.q)


def test_packet_from_the_future_is_ignored():
    """A clock that runs wrong must make the state stale, not fresh forever."""
    estimator = Estimator(SPEC, 1)
    for tick in range(10):
        estimator.step(tick * DT, sample([tick * DT], [True], np.full((1, N), 0.1)), still(1))
    for tick in range(10, 60):
        ahead = sample([tick * DT + 100.0], [True], np.full((1, N), 0.1))
        state = estimator.step(tick * DT, ahead, still(1))
    assert state.age[0] == pytest.approx(50 * DT)
    np.testing.assert_allclose(state.q, 0.1, atol=1e-3)


def test_soft_drives_do_not_predict_from_setpoints():
    """It is believed to be where one on a stiff drive would be that is never sent anywhere, to the last bit."""
    soft, stiff, rng = Estimator(SPEC, 2, springs=SOFT), Estimator(SPEC, 2), np.random.default_rng(16)
    for tick, received, _ in packets(rng, 2, 300, 0.2):
        jerked = Setpoint(*rng.normal(size=(3, 2, N)))
        believed, expected = soft.step(tick * DT, received, jerked), stiff.step(tick * DT, received, still(2))
        for name in ("q", "qd", "q_var", "age", "nis"):
            np.testing.assert_array_equal(getattr(believed, name), getattr(expected, name))
    soft.follow(np.array([True, False]), jerked, still(2))
    np.testing.assert_array_equal(soft.joints.e, stiff.joints.e)


@pytest.mark.parametrize(("share", "stuck"), [(0.9, False), (1.1, True)])
def test_encoder_on_a_soft_drive_is_stuck_if_torque_moves_nothing(share, stuck):
    """A leg that stands keeps its angle under less."""
    estimator, rng = Estimator(SPEC, 1, springs=SOFT), np.random.default_rng(17)
    away = share * STUCK_SHARE * torque_max(SPEC) / SOFT.kp
    for tick in range(100):
        q = 0.3 + rng.normal(0, NOISE, (1, N))
        q[0, 2] = q[0, 2] if tick < 50 else 0.3
        setpoint = still(1)._replace(q=np.zeros((1, N)) + away * min(max((tick - 60) / 30, 0.0), 1.0))
        state = estimator.step(tick * DT, sample([tick * DT], [True], q), setpoint)
    assert Reason(int(state.fault[0])) == (Reason.STUCK if stuck else Reason.NONE)


def test_compiled_kernels_give_the_bits_of_plain_python():
    plain = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    program = [sys.executable, "-m", "support.deploy.estimate_digest"]
    found = subprocess.run(program, env=plain, capture_output=True, text=True, check=False)
    assert (found.stdout, found.stderr) == (f"{estimate_digest()}\n", "")


def begun_at_rest():
    estimator = Estimator(SPEC, 1)
    for tick in range(100):
        estimator.step(tick * DT, sample([tick * DT], [True], still(1).q), still(1))
    return estimator


def test_refused_samples_count_in_a_row_only():
    """One gross error every few samples restarts no filter, however many there are."""
    estimator = begun_at_rest()
    for tick in range(100, 400):
        away = 0.4 if tick % 5 == 0 else 0.0
        state = estimator.step(tick * DT, sample([tick * DT], [True], still(1, away).q), still(1))
        assert np.abs(state.q).max() < 1e-3


DEPTH = round(HISTORY_S / DT)


@pytest.mark.parametrize(
    ("ticks", "used"),
    [(1.0, True), (1.5, False), (1 - DEPTH, True), (0.9 - DEPTH, False), (-2 * DEPTH, False)],
)
def test_packet_is_used_if_the_history_covers_its_time(ticks, used):
    """Up to a period ahead, and back to the oldest setpoint that is kept."""
    estimator, now = Estimator(SPEC, 1), 60
    for tick in range(now):
        estimator.step(tick * DT, sample([0.0], [False], still(1).q), still(1))
    t = (now + ticks + 1e-6) * DT if ticks < 1.0 else (now + ticks - 1e-6) * DT
    estimator.step(now * DT, sample([t], [True], still(1).q), still(1))
    assert estimator.joints.initialized.tolist() == [used]


def test_started_robot_has_no_fault_of_before():
    estimator = begun_at_rest()
    estimator.fault[:], estimator.stuck_detection.repeats[:] = int(Reason.LOAD), 7
    estimator.reset(np.ones(1, dtype=bool), still(1))
    tick = 101  # faults are not evaluated in this one
    state = estimator.step(tick * DT, sample([tick * DT], [True], still(1).q), still(1))
    assert state.fault.tolist() == [0]
    assert not estimator.stuck_detection.repeats.any()


@pytest.mark.parametrize(("away", "fused"), [(0.9 * GATE, True), (1.1 * GATE, False)])
def test_speed_packet_is_gated_and_fused_once(with_speed, away, fused):
    """S = p11 + r_speed + q |t − t_sample|, here with a packet that is two periods older than the angle's."""
    estimator, t = Estimator(with_speed, 1), 0.0
    for tick in range(50):
        t = tick * DT
        packets = sample([t], [True], still(1).q)
        packets["velocity"] = Packet(t=np.array([t]), fresh=np.array([tick < 45]), value=still(1).q)
        estimator.step(t, packets, still(1))
    joints, r_speed = estimator.joints, with_speed.sensors["velocity"].variance
    s = joints.p11 + r_speed + np.array(DENSITY) * 2 * DT
    ed, p11 = joints.ed.copy(), joints.p11.copy()
    value, old = ed + away * np.sqrt(s), Packet(np.array([t - 2 * DT]), np.ones(1, dtype=bool), None)
    joints.fuse_speeds(old._replace(value=value), old.fresh, still(1).qd)
    expected = ed + (p11 / s * (value - ed) if fused else 0.0)
    np.testing.assert_allclose(joints.ed, expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(joints.p11, p11 - (p11 / s * p11 if fused else 0.0), rtol=1e-9)
    joints.fuse_speeds(old._replace(value=value), old.fresh, still(1).qd)  # again: it is not newer
    np.testing.assert_allclose(joints.ed, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("kind", ["encoder", "velocity"])
def test_a_packet_without_a_value_for_each_joint_is_an_error(with_speed, kind):
    estimator = Estimator(with_speed, 1)
    packets = sample([0.0], [True], still(1).q)
    packets["velocity"] = packets["encoder"]
    packets[kind] = packets[kind]._replace(value=np.zeros((1, N - 1)))
    with pytest.raises(
        ValueError, match=rf"sensor {kind}: found values of shape \(1, 5\), expected \(1, 6\)"
    ):
        estimator.step(0.0, packets, still(1))


def test_packets_may_have_other_types_of_numbers():
    one, other = begun_at_rest(), begun_at_rest()
    t, value = np.float64(100 * DT), np.full((1, N), 0.5 * NOISE, dtype=np.float32)
    exact = one.step(float(t), sample([t], [True], value), still(1))
    narrow = {
        kind: Packet([t], [True], p.value.astype(np.float32))
        for kind, p in sample([t], [True], value).items()
    }
    found = other.step(float(t), narrow | {"current": sample([t], [True], value)["current"]}, still(1))
    np.testing.assert_array_equal(found.q, exact.q)


@pytest.mark.parametrize("hz", [1, 2])
def test_a_slow_robot_has_a_history_of_setpoints(hz):
    spec = SPEC.model_copy(update={"rates": Rates(control_hz=hz, physics_hz=hz)})
    estimator = Estimator(spec, 1)
    for tick in range(3):
        state = estimator.step(tick / hz, sample([tick / hz], [True], still(1, 0.3).q), still(1))
    np.testing.assert_allclose(state.q, 0.3, atol=1e-3)
