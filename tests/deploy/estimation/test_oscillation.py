import numpy as np
import pytest

from deploy.estimation.oscillation import SWING, WINDOW_S, OscillationDetection
from support.arm6 import SPEC

LOOK_S, N = 0.02, SPEC.n
QD_MAX, HZ = SPEC.joint_array("qd_max"), SPEC.margins.oscillation_hz


def found(hz, swing, seconds=10.0, noise=0.0, spec=SPEC):
    """Return (T, n) whether a sine of some frequency counts, with `swing` of the threshold between its peaks."""
    detection, rng = OscillationDetection(spec, 1, LOOK_S), np.random.default_rng(0)
    t = np.arange(0.0, seconds, LOOK_S)[:, None]
    qd = 0.5 * swing * SWING * QD_MAX * np.sin(2 * np.pi * hz * t) + noise * rng.standard_normal((len(t), N))
    return np.array([detection.step(each[None])[0] for each in qd])


@pytest.mark.parametrize(
    ("hz", "swing", "expected"),
    [(1.1 * HZ, 1.5, True), (0.9 * HZ, 1.5, False), (0.9 * HZ, 8.0, False), (2.0 * HZ, 0.9, False)],
)
def test_fast_and_wide_swings_count(hz, swing, expected):
    assert found(hz, swing).any(axis=0).tolist() == [expected] * N


def test_time_to_the_detection():
    """Closed form: the count of turning points at a rate r is r T (1 − exp(−t / T))."""
    hz = 1.5 * HZ
    expected = -WINDOW_S * np.log(1.0 - HZ / hz)
    first = found(hz, 3.0).argmax(axis=0) * LOOK_S
    np.testing.assert_allclose(first, expected, atol=1.0 / hz)


def test_noise_alone_does_not_count():
    assert not found(1.0, 0.0, noise=SWING * QD_MAX.min() / 8).any()


def test_one_move_after_another_does_not_count():
    assert not found(0.5, 20.0, noise=SWING * QD_MAX.min() / 8).any()


def test_it_ends_when_the_joint_rests():
    detection, t = OscillationDetection(SPEC, 2, LOOK_S), np.arange(0.0, 5.0, LOOK_S)
    for qd in QD_MAX * np.sin(2 * np.pi * 2 * HZ * t)[:, None]:
        last = detection.step(np.array([qd, np.zeros(N)]))
    assert last.tolist() == [[True] * N, [False] * N]
    for _ in range(round(2.0 * WINDOW_S / LOOK_S)):
        last = detection.step(np.zeros((2, N)))
    assert not last.any()


def test_reset_forgets_the_robot():
    detection = OscillationDetection(SPEC, 1, LOOK_S)
    detection.count[:] = 1e3
    assert detection.step(np.zeros((1, N))).all()
    detection.reset(np.array([True]))
    assert not detection.step(np.zeros((1, N))).any()


def test_robot_without_a_bound_never_oscillates():
    margins = SPEC.margins.model_copy(update={"oscillation_hz": None})
    assert not found(2.0 * HZ, 8.0, spec=SPEC.model_copy(update={"margins": margins})).any()
