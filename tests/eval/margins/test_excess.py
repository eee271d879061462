"""Excess over setpoints that are known."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")

import eval.margins.excess as module
from eval.margins.excess import BINS, GAP_S, MEAN_S, WINDOW_S, Excess
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from support.arm6 import SPEC

N, HOME, SPACE = SPEC.n, SPEC.joint_array("q_home"), SPEC.workspace
TOOL = Fleet(SPEC, 1).kinematics(HOME[None]).tool_position
WINDOW, GAP_TICKS = round(WINDOW_S / SPEC.dt), round(GAP_S / SPEC.dt)


class Distances:
    """Two pairs of shapes, 0.1 m apart."""

    def __init__(self, *_):
        self.nearer = np.zeros((1, 2))

    def planned(self, q):
        return np.full((1, 2), 0.1)

    def true(self):
        return 0.1 - self.nearer


class Bench:
    """One arm whose setpoint, command and truth are set by hand; it has had power for a whole window."""

    def __init__(self, monkeypatch):
        monkeypatch.setattr(module, "Gaps", Distances)
        row = np.zeros((1, N))
        self.sent = SimpleNamespace(q=row + HOME, qd=row.copy())
        self.command = SimpleNamespace(tau=row.copy(), powered=np.ones(1, dtype=bool))
        runtime = SimpleNamespace(
            spec=SPEC,
            setpoint=self.sent,
            command=self.command,
            robot=SimpleNamespace(robots=1),
            state=SimpleNamespace(q=row + HOME, qd=row.copy()),
        )
        self.state = runtime.state
        self.pushed = np.zeros(1, dtype=bool)
        self.excess = Excess(runtime, SimpleNamespace(valid=np.ones(1, dtype=bool)))
        self.truth = SimpleNamespace(
            q=row + HOME,
            qd=row.copy(),
            tau=row.copy(),
            valid=np.ones(1, dtype=bool),
            tool_position=TOOL.copy(),
            tool_velocity=np.zeros((1, 3)),
        )
        self.step(WINDOW + 1)

    def step(self, ticks=1):
        for _ in range(ticks):
            self.excess.step(self.truth, self.pushed)

    def largest(self, name):
        return self.excess.largest[name][0]


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def test_a_robot_at_its_setpoint_has_none(bench):
    for name in ("angle", "workspace", "gap"):
        assert bench.largest(name).max() == pytest.approx(0.0, abs=1e-12)
    for name in ("speed", "tau", "tool_speed"):  # over the upper end of their bin
        assert bench.largest(name).max() == pytest.approx(-1.0 / BINS)
    assert np.isinf(bench.largest("speed")[1:]).all()


def test_excess_is_over_the_largest_setpoint_of_the_window_in_its_bin(bench):
    limit = SPEC.joint_array("qd_max")
    bench.sent.qd[0, 1] = -0.55 * limit[1]
    bench.step()
    bench.sent.qd[0, 1] = 0.0
    bench.truth.qd[0, 1] = 0.65 * limit[1]
    bench.step(WINDOW - 1)
    assert bench.largest("speed")[5] == pytest.approx(0.05)
    assert bench.largest("speed")[0] == -0.1
    bench.step()
    assert bench.largest("speed")[0] == pytest.approx(0.55)


def test_angles_beyond_either_end_of_the_setpoints_count(bench):
    bench.truth.q[0, 0] -= 0.02
    bench.step()
    assert bench.largest("angle").max() == pytest.approx(0.02)


def test_torque_is_a_share_of_the_range(bench):
    bench.command.tau[0, 2] = 0.32 * torque_max(SPEC)[2]
    bench.truth.tau[0, 2] = -0.42 * torque_max(SPEC)[2]
    bench.step()
    assert bench.largest("tau")[3] == pytest.approx(0.02)
    assert len(bench.largest("tau")) == BINS


def test_tool_that_is_faster_lower_or_further_out(bench):
    bench.truth.tool_velocity[0, 2] = -0.05 * SPACE.tool_speed_max
    bench.truth.tool_position[0, 2] -= 0.01
    bench.step()
    assert bench.largest("tool_speed")[0] == pytest.approx(-0.05)
    assert bench.largest("workspace").max() == pytest.approx(0.01)
    outward = TOOL[0] - np.array(SPACE.centre)
    bench.truth.tool_position[0] = TOOL[0] + 0.02 * outward / np.linalg.norm(outward)
    bench.step()
    assert bench.largest("workspace").max() == pytest.approx(0.02)


def test_the_pair_that_came_nearest_counts(bench):
    bench.excess._gaps.nearer[:] = 0.004, -0.01
    bench.step(GAP_TICKS)
    assert bench.largest("gap").max() == pytest.approx(0.004)


def test_nothing_counts_until_a_whole_window_had_power(bench):
    bench.truth.q[0, 0] += 0.5
    bench.command.powered[0] = False
    bench.step()
    bench.command.powered[0] = True
    bench.step(WINDOW)
    assert bench.largest("angle").max() == 0.0
    bench.step()
    assert bench.largest("angle").max() == pytest.approx(0.5)


def test_a_simulation_that_diverged_does_not_count(bench):
    bench.truth.q[0, 0] += 0.5
    bench.truth.valid[0] = False
    bench.step(3 * WINDOW)
    assert bench.largest("angle").max() == 0.0


def test_error_of_the_estimate_is_over_the_tick_before(bench):
    assert bench.excess.estimate_error.max() == 0.0
    bench.truth.q[0, 0] += 0.02
    bench.step()
    assert bench.excess.estimate_error.max() == 0.0
    for _ in range(2):
        bench.state.q[0, 1] = HOME[1] + 0.01
        bench.step()
    expected = np.zeros((2, N))
    second = 1 - SPEC.dt / MEAN_S  # the first one is part of the mean by then
    expected[0, :2] = np.array([0.02, 0.01]) * np.sqrt((1 + second**2) / bench.excess._counted[0])
    np.testing.assert_allclose(bench.excess.estimate_error, expected, rtol=1e-9)


def test_error_of_the_estimate_that_lasts_is_no_noise(bench):
    """Noise of 0.01 rad is found under a mean error of 0.05 rad, after two seconds in which the mean is."""
    noise = np.random.default_rng(0).normal(0.0, 0.01, 4000)
    for error in noise[:400]:
        bench.state.q[0, 0] = HOME[0] + 0.05 + error
        bench.step()
    bench.excess._squares[:], bench.excess._counted[:] = 0.0, 0
    for error in noise:
        bench.state.q[0, 0] = HOME[0] + 0.05 + error
        bench.step()
    assert bench.excess.estimate_error[0, 0] == pytest.approx(0.01, rel=0.05)


def test_error_of_the_estimate_of_an_arm_that_is_pushed_is_no_noise(bench):
    bench.truth.q[0, 0] += 0.02
    bench.step()
    bench.pushed[0] = True
    bench.step(20)
    assert bench.excess.estimate_error.max() == 0.0
    bench.pushed[0] = False
    bench.step()
    assert bench.excess.estimate_error.max() > 0.0
