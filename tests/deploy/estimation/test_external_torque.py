from itertools import count

import numpy as np
import pytest

from deploy.estimation.external_torque import DETECTION_S, TORQUE_SHARE, ExternalTorque
from deploy.reasons import LATCHING, Reason
from deploy.state import Mode, Packet
from robots.models.nominal_model import torque_max
from robots.motors.windings import nominal_windings
from support.arm6 import SPEC

N, LOOK_S = SPEC.n, 0.02
LOOKS = round(DETECTION_S / LOOK_S)
CONSTANT, LIMIT = nominal_windings(SPEC).constant, torque_max(SPEC)
TAU = np.array([40.0, -60.0, 20.0, 4.0, -2.0, 1.0])
HAIR = 1e-6


def current(tau):
    """A, of motors that give (n,) N·m."""
    return np.atleast_2d(tau / CONSTANT)


TIMES = count(step=0.016)


def look(load, value, t=None):
    """At currents (B, n) A that were taken at t, by default later than all before."""
    robots = len(value)
    t = next(TIMES) if t is None else t
    return load.look(Packet(np.full(robots, t), np.ones(robots, dtype=bool), value))


def asked(robots=1):
    load = ExternalTorque(SPEC, robots, LOOK_S)
    load.command(np.tile(TAU, (robots, 1)), np.ones(robots, dtype=bool))
    return load


def strayed(joint, share):
    tau = TAU.copy()
    tau[joint] += share * LIMIT[joint]
    return current(tau)


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("sign", [-1, 1])
def test_persistent_torque_residual_is_detected_after_the_debounce(joint, sign):
    for factor, seen in ((1 - HAIR, False), (1 + HAIR, True)):
        load = asked()
        found = [look(load, strayed(joint, sign * factor * TORQUE_SHARE))[0] for _ in range(LOOKS + 1)]
        assert found == [False] * (LOOKS - 1) + [seen] * 2


def test_residual_must_persist_without_interruption():
    load = asked()
    for _ in range(3):
        for _ in range(LOOKS - 1):
            assert not look(load, strayed(2, 1.0)).any()
        assert not look(load, strayed(2, 0.0)).any()


def test_current_of_nan_neither_counts_nor_clears():
    load = asked()
    for _ in range(LOOKS - 1):
        assert not look(load, strayed(2, 1.0)).any()
        assert not look(load, strayed(2, np.nan)).any()
    assert look(load, strayed(2, 1.0)).all()


def test_packet_counts_once():
    load, late = asked(), next(TIMES)
    for _ in range(2 * LOOKS):
        assert not look(load, strayed(2, 1.0), t=late).any()
    for _ in range(LOOKS - 2):
        assert not look(load, strayed(2, 1.0)).any()
    late = next(TIMES)
    assert all(look(load, strayed(2, 1.0), t=late).all() for _ in range(3))


def test_robots_are_judged_separately_and_only_with_power():
    """Brakes carry the arm then, and motors give nothing."""
    load, hard = asked(4), np.repeat(strayed(0, 1.0), 4, axis=0)
    hard[1] = current(TAU)
    for _ in range(LOOKS):
        load.command(load.tau, np.array([True, True, False, True]))
        found = look(load, hard)
    assert found.tolist() == [True, False, False, True]
    load.reset(np.array([True, False, False, False]))
    assert look(load, hard).tolist() == [False, False, False, True]


def test_saved_state_restores_the_detection():
    load, other = asked(), ExternalTorque(SPEC, 1, LOOK_S)
    for _ in range(LOOKS - 1):
        look(load, strayed(4, -1.0))
    other.restore(load.save())
    assert look(other, strayed(4, -1.0)).all()


def running(**how):
    pytest.importorskip("mujoco")
    from support.runtimes import running

    return running(2, **how)


@pytest.mark.parametrize("joint", [0, 3])
def test_weakly_pushed_blocked_joint_stops_its_robot(joint):
    """By 20 mrad, which no bound of tracking sees; nobody else stops."""
    from support.runtimes import Saying

    policy = Saying(2)
    runtime = running(policy=policy)
    for _ in range(100):  # to rest
        runtime.tick()
    goal = runtime.action.value[:, joint] + 0.02
    modes, reasons = [], Reason.NONE
    plant = runtime.robot.plant
    for _ in range(60):
        plant.batch.expand("dof_frictionloss")[1, plant.dofs[joint]] = 1e5
        policy.action[:, joint] = (goal - runtime.action.value[:, joint]) / runtime.contract.action.scale[
            joint
        ]
        runtime.tick()
        reasons |= Reason(int(runtime.verdict.reason[1] | runtime.state.fault[1]))
        modes.append(runtime.supervisor.mode.copy())
    assert reasons == Reason.LOAD
    assert np.array(modes)[-1].tolist() == [Mode.RUNNING, Mode.LATCHED]
    assert Reason.LOAD & LATCHING
