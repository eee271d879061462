from functools import cache

import numpy as np
import pytest

from deploy.stage import Stage
from deploy.state import Mode
from robots.randomness import robot_seed
from support.arm6 import SPEC
from support.contracts import arm_contract

simulate = pytest.importorskip("deploy.simulation").simulate
ARM_S = pytest.importorskip("eval.shard.job").ARM_S


N, DT = SPEC.n, SPEC.dt


class Thinking(Stage):
    """What may stand in for a policy: it remembers nothing."""

    failure = ""

    def resize(self, robots):
        pass

    def reset(self, ids):
        pass


class Wandering(Thinking):
    """A policy without a purpose: a fixed random function of the observation."""

    def __init__(self, contract, seed=0, gain=2.0):
        rng = np.random.default_rng(seed)
        self.weights = gain * rng.normal(size=(contract.observation_size, contract.action_size)).astype(
            np.float32
        )

    def step(self, observation):
        # Row by row: a matrix product may depend on its width in the last bit.
        return np.stack([np.tanh((row[:, None] * self.weights).sum(axis=0)) for row in observation])


class Saying(Thinking):
    """A policy that says what it is told to."""

    def __init__(self, robots):
        self.action = np.zeros((robots, N))

    def step(self, observation):
        return self.action


def built(robots=2, seed=5, *, policy=None, threads=1, only=None, contract=None, faults=()):
    """A runtime on simulated robots, not yet armed."""
    contract = contract or arm_contract()
    seeds = [robot_seed(seed, robot) for robot in (range(robots) if only is None else only)]
    policy = policy or Wandering(contract)
    return simulate(SPEC, contract, seeds, policy, threads=threads, faults=faults)[0]


def every(runtime, value=True):
    return np.full(runtime.robot.robots, value)


def heard(runtime):
    """Ticks until the estimators are confirmed."""
    for _ in range(round(ARM_S / DT)):
        runtime.tick()


def running(robots=2, seed=5, **how):
    """The same, armed and under way."""
    runtime = built(robots, seed, **how)
    if how:
        _start(runtime)
    else:
        state, body = _under_way(robots, seed)
        runtime.restore(state)
        runtime.robot.restore(body)
    runtime.tick()
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    return runtime


@cache
def _under_way(robots, seed):
    """State of runtime and robots a tick earlier, simulated once in a process."""
    runtime = built(robots, seed)
    _start(runtime)
    return runtime.save(), runtime.robot.save()


def _start(runtime):
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    for _ in range(24):
        runtime.tick()


def assert_within_limits(q):
    """By backward differences of what was sent, (T, B, n)."""
    derivative = q
    for name, share in (("qd_max", SPEC.margins.speed), ("qdd_max", 1.0), ("qddd_max", 1.0)):
        derivative = np.diff(derivative, axis=0) / DT
        assert (np.abs(derivative) <= share * SPEC.joint_array(name) * (1 + 1e-4)).all(), name


def play(runtime, ticks):
    """Every command sent, angles (T, B, n), and every mode (T, B)."""
    q, modes = [], []
    for _ in range(ticks):
        runtime.tick()
        assert np.isfinite(runtime.command.q + runtime.command.qd + runtime.command.tau).all()
        q.append(runtime.command.q.copy())
        modes.append(runtime.supervisor.mode.copy())
    return np.array(q), np.array(modes)


def bits(runtime):
    """Everything that a tick leaves behind."""
    truth = runtime.robot.truth()
    return {
        "rows": runtime.robot.plant.rows.copy(),
        "command": np.stack((runtime.command.q, runtime.command.qd, runtime.command.tau)),
        "state": np.stack((runtime.state.q, runtime.state.qd)),
        "verdict": runtime.verdict.reason.copy(),
        "goal": runtime.task.goal.copy(),
        "mode": runtime.supervisor.mode.copy(),
        "frames": runtime.observation.frames.copy(),
        "housing": truth.housing_c.copy(),
    }


def assert_same(one, other):
    for name, array in bits(one).items():
        np.testing.assert_array_equal(bits(other)[name], array, err_msg=name)
