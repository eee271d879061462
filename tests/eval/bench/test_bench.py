from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from support.arm6 import SPEC
from support.policies import N, policy_model, saved

pytest.importorskip("mujoco")

from mujoco.batch import Batch

import eval.bench.__main__ as command
from deploy.command_line import main
from deploy.policy.policy import Policy
from eval.bench import stages, stopwatch
from eval.bench.baselines.library_loop import LibraryLoop
from eval.bench.budget_check import make_idle
from eval.bench.estimation.encoder_plot import draw_encoder
from eval.bench.estimation.estimate import consistency, error_row, outage
from eval.bench.estimation.recorded_motion import Motion, estimate_motion
from eval.bench.reproducibility import differences
from eval.bench.stopwatch import Stopwatch
from eval.bench.throughput import RolloutReplay
from robots.distributions import load_distributions
from robots.draws import draw
from robots.models.mujoco_model import load_mujoco
from robots.randomness import robot_seed


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


@pytest.mark.slow
def test_a_bench_watches_every_stage_and_leaves_the_results_alone(arm_policy, monkeypatch):
    monkeypatch.setattr(stages, "WARM_S", 0.25)
    bench = stages.StageBench(SPEC, arm_policy, 2, every_stage=True)
    bench.run(8)
    calls = {name: len(samples) for name, samples in bench.stopwatch.samples.items()}
    assert calls.pop("observation") == calls.pop("policy") == 2
    assert calls.pop("action") == 2
    assert set(calls.values()) == {8}
    assert bench.judge.counts().running.min() > 30


def test_physics_is_timed_on_the_recorded_steps():
    """From the same state, by the same controls, to the same state; and nothing but physics is done again."""
    batch, rng = Batch(load_mujoco(SPEC), 3, nthread=1), np.random.default_rng(1)
    physics = RolloutReplay(batch)
    for _ in range(2):
        physics.record()
        for _ in range(4):
            batch.rollout(5, control=rng.normal(0, 1, (3, 5, batch.model.nu)), record=())
        end = batch.state.copy()
        batch.state[:] = 0.0
        physics.replay()
        np.testing.assert_array_equal(batch.state, end)


def test_the_library_loop_moves_its_robot(arm_policy):
    robot = LibraryLoop(SPEC, Policy.load(arm_policy, SPEC).contract, arm_policy)
    robot.target[:] += 0.2
    robot.decimation = 10**9
    for number in range(1, 400):
        robot.tick(number)
    np.testing.assert_allclose(robot.data.qpos, robot.target, atol=0.01)


@pytest.mark.slow
def test_errors_of_the_estimator_are_measured_against_the_true_motion(tmp_path):
    """On a motion and a delay that are known: raw angles are two ticks old, estimates are not."""
    seeds = [robot_seed(2, robot) for robot in range(4)]
    plain = {f"sensors.{name}": 0.0 for name in ("bias", "drift", "jitter", "loss", "repeat")}
    drawn = draw(load_distributions(SPEC), SPEC, seeds).replaced({**plain, "sensors.delay": 1.0})
    t = SPEC.dt * np.arange(1, 1001)[:, None, None] + np.arange(4)[:, None] + np.arange(SPEC.n) / 2
    q, qd = 0.2 * np.sin(2 * t), 0.4 * np.cos(2 * t)
    sent = np.concatenate((q + 0.01, qd), axis=2)  # a steady error of what was sent
    motion = Motion(q=q, qd=qd, encoder_q=q, sent=sent, draw=drawn, seeds=seeds)
    raw, q, differenced, qd, ratio, late, left = (
        float(word.split()[0]) for word in error_row(SPEC, [motion], 0.001)
    )
    assert late == pytest.approx(10.0, abs=0.2)
    assert abs(left) < 1.0
    assert raw == pytest.approx(np.hypot(1e3 * 0.010 * 0.4 / np.sqrt(2), 1.0), rel=0.03)
    assert q < raw / 2
    assert differenced == pytest.approx(
        np.sqrt(2) * np.hypot(1.0, SPEC.sensors["encoder"].resolution * 1e3 / np.sqrt(12)) / SPEC.dt, rel=0.05
    )
    assert ratio == pytest.approx(qd / differenced, abs=0.001)
    assert outage(SPEC, motion).startswith("100 ms without a packet: error up to ")
    assert "mean NEES" in consistency(SPEC, [motion])
    draw_encoder(SPEC, motion, estimate_motion(SPEC, motion, None), tmp_path / "encoder.png")
    assert (tmp_path / "encoder.png").read_bytes().startswith(b"\x89PNG")


def test_idle_policy_loads_and_outputs_zero(tmp_path):
    working = saved(policy_model(), tmp_path)
    idle = Policy.load(make_idle(working, tmp_path / "idle.onnx"), SPEC)
    observation = np.random.default_rng(0).normal(size=(3, N)).astype(np.float32)
    assert not idle.step(observation).any()
    assert Policy.load(working, SPEC).step(observation).any()


def test_an_unknown_bench_is_refused(call):
    code, _, said = call(lambda: main(command.bench), "nothing")
    assert code == 2
    assert "found 'nothing', expected one of stages, throughput, " in said
    assert said.rstrip().endswith(", teleport, adversaries, faults, stops, walk or all")


def test_figure_omits_what_cannot_be_drawn(call, monkeypatch):
    seen = []
    monkeypatch.setitem(
        command.BENCHES, "ablation", lambda spec, policy, console, picture: seen.append(picture)
    )
    picture = ("--picture", "figures.png")
    assert call(lambda: main(command.bench), "ablation", *picture)[0] == 0
    code, _, said = call(lambda: main(command.bench), "startup", *picture)
    assert (code, seen) == (2, [Path("figures.png")])
    assert "--picture figures.png: found 'startup', expected estimate or ablation" in said


def test_differences_between_results_are_named():
    @dataclass
    class Result:
        heat: np.ndarray
        names: tuple[str, ...] = ("a",)

    one, other = (
        [Result(np.array([1.0, np.nan])), Result(np.array(last))] for last in ([1.0, 2.0], [1.0, 2.5])
    )
    assert differences(one, one) == set()
    assert differences(one, other) == {"shard 1 heat"}
    other[0].names = ("b",)
    assert differences(one, other) == {"shard 0 names", "shard 1 heat"}
    with pytest.raises(ValueError, match="zip"):
        differences(one, other[:1])
