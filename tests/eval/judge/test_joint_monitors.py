"""Monitors of joints: limit attacks on every joint, and values that cannot be judged."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.arm6 import SPEC
from support.eval.judges import (
    HOME,
    LIMITS,
    POWER,
    Q_MAX,
    Q_MIN,
    TORQUE_MAX,
    Bench,
    N,
    hold,
)

HAIR = 1e-6
SOFT = SPEC.margins.q_soft_rad
ALONG = {"heat_hard": {"heat_soft"}, "position_hard": {"position_soft"}}


def work(bench, joint, power):
    """So fast that a little torque is much power, whose sign does not matter."""
    bench.truth.qd[0, joint], bench.truth.tau[0, joint] = -2.0, power / 2.0


ATTACKS = {
    "position_requested": lambda b, j, by: b.target.value[0].__setitem__(j, Q_MAX[j] + by),
    "position_soft": lambda b, j, by: hold(b, j, Q_MAX[j] - SOFT + by),
    "position_hard": lambda b, j, by: hold(b, j, Q_MIN[j] - by),
    "velocity": lambda b, j, by: b.truth.qd[0].__setitem__(j, -SPEC.joints[j].qd_max - by),
    "torque": lambda b, j, by: b.truth.tau[0].__setitem__(j, -0.999 * TORQUE_MAX[j] - by),
    "power": lambda b, j, by: work(b, j, POWER[j] + by),
    "estimate": lambda b, j, by: b.off[0].__setitem__(j, -1e-3 * np.sqrt(LIMITS.nees + by)),
    "heat_soft": lambda b, j, by: b.truth.winding_c[0].__setitem__(
        j, SPEC.motor_array("winding_soft_c")[j] + by
    ),
    "heat_hard": lambda b, j, by: b.truth.winding_c[0].__setitem__(
        j, SPEC.motor_array("winding_max_c")[j] + by
    ),
    "tracking": lambda b, j, by: b.truth.q[0].__setitem__(j, HOME[j] + SPEC.margins.tracking_rad + by),
}


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("name", ATTACKS)
def test_just_above_a_joint_limit_fires_and_just_below_does_not(name, joint):
    over, under = Bench(robots=2), Bench(robots=2)
    ATTACKS[name](over, joint, HAIR)
    ATTACKS[name](under, joint, -HAIR)
    over.step(5)
    under.step(5)
    assert over.fired() == {name} | ALONG.get(name, set())
    assert name not in under.fired()
    assert (
        over.judge.counts().events[0, over.judge.counts().columns(name)].tolist() == np.eye(N)[joint].tolist()
    )
    assert not over.judge.counts().events[1].any()


@pytest.mark.parametrize("name", [*ATTACKS, "workspace", "tool_speed"])
def test_nan_fires(name):
    bench = Bench()
    if name in ATTACKS:
        ATTACKS[name](bench, 2, np.nan)
    else:
        bench.truth.tool_position[:] = bench.truth.tool_velocity[:] = np.nan
    bench.step(3)
    assert name in bench.fired()
    counts = bench.judge.counts()
    assert np.isinf(counts.worst[:, counts.columns(name)].max())
    assert not np.isnan(counts.worst).any()


def test_tracking_is_not_judged_without_power():
    bench = Bench()
    bench.powered[:] = False
    bench.sent[:] = np.nan
    bench.step(5)
    assert bench.fired() == set()


@pytest.mark.parametrize("field", ["age", "valid"])
def test_invalid_estimate_is_not_judged(field):
    bench = Bench()
    bench.off[:] = 1.0
    if field == "age":
        bench.age[:] = np.inf
        bench.q_var[:] = 0.0
        bench.step(3)
        assert bench.fired() == set()
    else:
        bench.truth.valid[:] = False
        bench.step()
        bench.truth.valid[:] = True
        bench.step()
        assert bench.fired() == set()
        bench.step()
        assert bench.fired() == {"estimate"}
