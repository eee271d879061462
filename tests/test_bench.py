import sys

import numpy as np
import pytest
from test_policy import N, policy_model, saved
from test_spec import SPEC

pytest.importorskip("mujoco")

from deploy.policy import Policy
from eval.bench import __main__ as command
from eval.bench import stages, stopwatch
from eval.bench.idle import make_idle
from eval.bench.plain import PlainRobot
from eval.bench.stopwatch import Stopwatch


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


class Work:
    def __init__(self, clock):
        self.clock = clock

    def outer(self):
        self.clock.now += 1.0
        self.inner()
        self.inner()
        return "done"

    def inner(self):
        self.clock.now += 0.25


def test_time_is_counted_once_where_it_was_spent(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(stopwatch.time, "perf_counter", clock)
    watch, work = Stopwatch(), Work(clock)
    watch.watch("outer", work, "outer")
    watch.watch("inner", work, "inner")
    assert work.outer() == "done"
    assert (watch.total("outer"), watch.total("inner")) == (1.0, 0.5)
    watch.clear()
    work.inner()
    assert (watch.total("outer"), watch.total("inner")) == (0.0, 0.25)


def test_a_bench_watches_every_stage_and_leaves_the_results_alone(arm_policy, quick_goals, monkeypatch):
    monkeypatch.setattr(stages, "WARM_S", 0.25)
    bench = stages.Bench(SPEC, arm_policy, 2, every_stage=True)
    bench.run(8)
    calls = {name: len(samples) for name, samples in bench.watch.samples.items()}
    assert calls.pop("observation") == calls.pop("policy") == 2
    assert calls.pop("action") == 2
    assert set(calls.values()) == {8}
    assert bench.judge.counts().running.min() > 30


def test_the_plain_composition_moves_its_robot(arm_policy):
    robot = PlainRobot(SPEC, Policy.load(arm_policy, SPEC).contract, arm_policy)
    robot._target[:] += 0.2
    robot._decimation = 10**9
    for number in range(1, 400):
        robot.tick(number)
    np.testing.assert_allclose(robot._data.qpos, robot._target, atol=0.01)


def test_an_idle_policy_loads_and_asks_for_nothing(tmp_path):
    working = saved(policy_model(), tmp_path)
    idle = Policy.load(make_idle(working, tmp_path / "idle.onnx"), SPEC)
    observation = np.random.default_rng(0).normal(size=(3, N)).astype(np.float32)
    assert not idle.step(observation).any()
    assert Policy.load(working, SPEC).step(observation).any()


def test_an_unknown_bench_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bench", "nothing"])
    with pytest.raises(SystemExit) as caught:
        command.main(command.bench)
    assert caught.value.code == 2
    assert "found 'nothing', expected one of stages, start, memory, work or all" in capsys.readouterr().err
