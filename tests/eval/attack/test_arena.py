"""Trials on simulated robots: the same whatever was tried before, and replayed from a bundle."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

import eval.attack.arena as module
from eval.attack.adversaries import ADVERSARIES
from eval.attack.arena import Arena, Setting, make_shard, write_job
from eval.attack.candidate import Block, Candidate
from eval.attack.guards import find_guard
from eval.attack.loaded_robots import LIVES, extra_load
from eval.attack.peak import write_peak
from eval.replay import bundle
from eval.replay.replay_text import mismatch
from eval.replay.replayer import Replay
from eval.shard.job import WIDTH
from robots.distributions import load_distributions
from robots.draws import draw
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from support.arm6 import SPEC

SETTING = Setting(robot=SPEC.folder, mode=ControlMode.POSITION)
SEED = 7
MONITOR = "velocity"


def first(name):
    return ADVERSARIES[name].first(SPEC.n)


@pytest.fixture
def short(monkeypatch):
    """Trials of a third of a second in operation."""
    monkeypatch.setattr(module, "EPISODE_S", 0.55)


@pytest.fixture
def arena(short):
    return Arena(SETTING, SEED)


def same(a, b):
    return a.worst.keys() == b.worst.keys() and all(
        (a.worst[name] == b.worst[name]).all() for name in a.worst
    )


@pytest.mark.slow
def test_trial_is_the_same_whatever_was_tried_before_and_for_whichever_robots_besides(arena):
    blocks = [Block(name, (first(name),) * WIDTH, SEED) for name in ("anti_damping", "network")]
    outcomes = [arena.try_block(block) for block in blocks]
    mixed = arena.try_block(Block("", tuple(block.rows[0] for block in blocks) * (WIDTH // 2), SEED))
    for k, (block, outcome) in enumerate(zip(blocks, outcomes, strict=True)):
        assert same(outcome, arena.try_block(block))
        assert same(outcome, arena.try_candidate(block.candidate(0)))
        for name, ratios in mixed.worst.items():
            np.testing.assert_array_equal(ratios[k::2], outcome.worst[name][k::2])
    assert not same(*outcomes)


@pytest.mark.parametrize("effect", [None, "load"])
def test_memory_of_an_arena_is_freed_with_it(effect, short, monkeypatch):
    """Without the garbage collector, which does not know how much memory simulations need."""
    monkeypatch.setattr("eval.attack.pushed_arm.ARMS", WIDTH)
    gc.collect()
    gc.disable()
    try:
        arena = Arena(SETTING, SEED, effect)
        name = "loaded_arm" if effect else "push"
        arena.try_block(Block(name, (first(name),) * WIDTH, SEED))
        parts = [weakref.ref(part) for part in (arena._shard.runtime, arena._shard.robot.plant)]
        del arena
        assert [part() for part in parts] == [None, None]
    finally:
        gc.enable()


def test_robots_of_a_setting_are_loaded_and_worn_or_those_that_its_seed_draws(tmp_path):
    candidate = Candidate("push", first("push"), SEED)
    job = write_job(SETTING, SPEC, candidate, tmp_path / bundle.POLICY)
    drawn = draw(load_distributions(SPEC), SPEC, [robot_seed(SEED, robot) for robot in range(WIDTH)])
    plain = make_shard(replace(SETTING, loaded=False), job, candidate).robot
    loaded = make_shard(SETTING, job, candidate).robot
    assert extra_load(SPEC, loaded.draw).mean() > 1.3 * extra_load(SPEC, drawn).mean()
    assert (loaded.draw["push.every_s"] < drawn["push.every_s"].min()).all()
    assert all((plain.draw[name] == values).all() for name, values in drawn.items())
    assert not plain.plant.wear.life.any()
    np.testing.assert_array_equal(loaded.plant.wear.life[[0, -1]], [[0.0] * SPEC.n, [LIVES] * SPEC.n])


@pytest.mark.slow
def test_peak_of_a_candidate_is_replayed_from_its_bundle_bit_for_bit(short, tmp_path):
    candidate = Candidate("anti_damping", first("anti_damping"), SEED)
    written = write_peak(SETTING, MONITOR, candidate, tmp_path / "worst")
    assert written.ratio == Arena(SETTING, SEED).try_candidate(candidate).worst[MONITOR].max()
    folder = tmp_path / "worst" / written.name
    event = bundle.open_bundle(folder).event
    assert (event.monitor, event.worst, event.peak) == (MONITOR, written.ratio, True)
    replay = Replay(folder)
    again = replay.run()
    assert mismatch(replay, again) == ""
    assert again.load[event.start - replay.info.begin] == event.worst == again.load.max()


def test_records_of_events_are_the_same_as_before_there_were_peaks():
    event = {"robot": 1, "monitor": MONITOR, "joint": "elbow", "start": 5, "ticks": 2, "worst": 1.1}
    assert bundle.EventRecord(**event).model_dump() == event
    assert bundle.EventRecord(**event, peak=True).model_dump() == event | {"peak": True}


@pytest.mark.parametrize("part", ["no such guard", "safety:"])
def test_guard_that_is_not_exactly_one_is_refused_by_name(part):
    with pytest.raises(ConfigError, match=f"--without {part!r}: found"):
        find_guard(part)
