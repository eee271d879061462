"""Pushed arms: which arm it is, its push and lost packets, and the gains of its drives."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

import eval.attack.arena as arena_module
import eval.attack.pushed_arm as module
from deploy.policy.compatibility import check_contract
from deploy.state import Mode
from eval.attack import lost_packets
from eval.attack.adversaries import ADVERSARIES, pushed_arms
from eval.attack.arena import Arena, Setting, write_job
from eval.attack.candidate import Block, Candidate
from eval.attack.loaded_robots import LIVES, extra_load, sag
from eval.attack.peak import write_peak
from eval.attack.policy_graph import attack_contract
from eval.attack.pushed_arm import PushedArm, choose_arm, gains_of
from eval.attack.throws import throws
from eval.attack.trained_gains import TrainedGains, extreme_gains
from eval.replay import bundle
from eval.replay.replay_text import mismatch
from eval.replay.replayer import Replay
from eval.shard.job import ARM_S, WIDTH
from robots.distributions import load_distributions
from robots.draws import draw
from robots.motors.control_mode import ControlMode
from robots.randomness import Stream, robot_seed, stream_keys
from support.arm6 import SPEC

SETTING = Setting(robot=SPEC.folder, mode=ControlMode.POSITION)
SEED, LOSSY, ARMS, WRIST = 5, 2, 48, 3
"""Wrist_1 is the third of the joints that a push throws fastest: the one of both seeds. With the second one, of 8 arms
the one that loses most packets is taken."""
EFFECTS = {
    "load": lambda robots: extra_load(SPEC, robots),
    "sag": lambda robots: sag(SPEC, robots),
    "throw": lambda robots: throws(SPEC, robots).speed[:, WRIST].max(axis=1),
    "tool": lambda robots: throws(SPEC, robots).tool,
}
NAMES = [name for name, adversary in ADVERSARIES.items() if adversary.effect]


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Fewer arms and streams of packets, and trials of 0.6 s in operation."""
    monkeypatch.setattr(module, "ARMS", ARMS)
    monkeypatch.setattr(lost_packets, "STREAMS", lost_packets.ROWS)
    monkeypatch.setattr(arena_module, "EPISODE_S", 0.8)


def weights(name="loaded_arm", **changed):
    return {**ADVERSARIES[name].first(SPEC.n), **changed}


@pytest.mark.parametrize("effect", EFFECTS)
def test_arm_is_the_one_of_many_on_which_a_push_has_most_effect(effect):
    robots = draw(load_distributions(SPEC), SPEC, [robot_seed(SEED, robot) for robot in range(ARMS)])
    found, link = choose_arm(SPEC, effect, SEED)
    assert found.robots == WIDTH
    np.testing.assert_array_equal(EFFECTS[effect](found), EFFECTS[effect](robots).max())
    if effect == "throw":
        speed = throws(SPEC, found).speed[0, WRIST]
        assert speed[link] == speed.max()
    else:
        assert link == SPEC.n - 1


@pytest.mark.parametrize("effect", EFFECTS)
def test_of_arms_with_most_effect_some_seeds_take_the_one_that_loses_most_packets(effect):
    robots = draw(load_distributions(SPEC), SPEC, [robot_seed(LOSSY, robot) for robot in range(ARMS)])
    most = np.argsort(-EFFECTS[effect](robots))[: module.ALIKE]
    encoder = list(SPEC.sensors).index("encoder")
    losses = (robots["sensors.loss"] * robots["sensors.burst"])[most, encoder]
    found, _ = choose_arm(SPEC, effect, LOSSY)
    np.testing.assert_array_equal(found["links.mass"], robots["links.mass"][[most[losses.argmax()]] * WIDTH])


@pytest.fixture
def arm(tmp_path):
    """A pushed arm, and its draw."""
    job = write_job(SETTING, SPEC, Candidate("loaded_arm", weights(), SEED), tmp_path / bundle.POLICY)
    return PushedArm(job, SPEC, "load"), choose_arm(SPEC, "load", SEED).robots


def test_push_has_the_moment_and_direction_of_its_weights_and_what_else_is_drawn(arm):
    pushed, robots = arm
    toward = np.random.default_rng(1).standard_normal((WIDTH, 3))
    after, refused = [0.2, -0.1] * (WIDTH // 2), 0.2 + 0.01 * np.arange(WIDTH)
    moments = [{"force_s": (a,), "refused_s": (r,)} for a, r in zip(after, refused, strict=True)]
    pushed.push([weights(**at, force_toward=tuple(x)) for at, x in zip(moments, toward, strict=True)])
    plant = pushed.shard.robot.plant
    assert (plant.wear.life == LIVES).all()
    applied, links = plant.batch.bind("xfrc_applied"), plant.bodies
    begins, ends = np.full(WIDTH, -1), np.full(WIDTH, -1)
    for tick in range(260):
        pushed.shard.tick()
        on = (applied[:, links] != 0.0).any(axis=(1, 2))
        begins[on & (begins < 0)] = tick
        ends[~on & (begins >= 0) & (ends < 0)] = tick
        for robot in np.flatnonzero(on & (begins == tick)):
            force = applied[robot, links[-1], :3]
            assert np.linalg.norm(force) == pytest.approx(robots["push.force_n"][robot])
            cosine = force @ toward[robot] / np.linalg.norm(force) / np.linalg.norm(toward[robot])
            assert cosine > np.cos(0.2)
            assert not applied[robot, links[:-1]].any()
    np.testing.assert_array_equal(begins, np.rint((ARM_S + refused + after) / SPEC.dt))
    np.testing.assert_array_equal(ends - begins, np.rint(robots["push.lasts_s"] / SPEC.dt))
    assert plant.disturbances["payload"].on.all()


def test_stop_begins_in_the_tick_of_an_action_that_is_no_number(tmp_path):
    refused_s = 0.21
    job = write_job(
        SETTING,
        SPEC,
        Candidate("loaded_arm", weights(refused_s=(refused_s,)), SEED),
        tmp_path / bundle.POLICY,
    )
    shard, at = PushedArm(job, SPEC, "load").shard, round((ARM_S + refused_s) / SPEC.dt)
    modes = []
    for _ in range(at + 1):
        shard.tick()
        modes.append(shard.runtime.supervisor.mode.copy())
    assert (modes[at - 1] == Mode.RUNNING).all()
    assert (modes[at] == Mode.STOPPING).all()


def ages(pushed, ticks):
    """Run some ticks; return (T, B) ticks since the newest reading of the encoder was taken."""
    encoder, sensors, found = list(SPEC.sensors).index("encoder"), pushed.shard.robot.sensors, []
    for tick in range(ticks):
        pushed.shard.tick()
        found.append(tick - sensors.sampled[:, encoder])
    return np.array(found)


def test_packets_are_latest_at_the_moment_of_the_weights_and_a_snapshot_holds_their_streams(arm):
    """Of streams that were tried one by one, by the ages in the runtime."""
    pushed, _ = arm
    start, sensors, at = pushed.shard.snapshot(), pushed.shard.robot.sensors, 60 + np.arange(WIDTH)
    usual = ages(pushed, 90)
    pushed.shard.restore(start)
    pushed.push(
        [
            weights(refused_s=(0.2,), lost_s=(tick * SPEC.dt - 0.4,), force_toward=(1.0, 0.0, 0.0))
            for tick in at
        ]
    )
    chosen, keys = ages(pushed, 90), sensors.packet_keys.copy()
    assert chosen[at, np.arange(WIDTH)].sum() > usual[at, np.arange(WIDTH)].sum()
    rest = pushed.shard.snapshot()
    on = ages(pushed, 20)
    pushed.shard.restore(start)
    np.testing.assert_array_equal(ages(pushed, 90), usual)
    pushed.shard.restore(rest)
    np.testing.assert_array_equal(sensors.packet_keys, keys)
    np.testing.assert_array_equal(ages(pushed, 20), on)
    pushed.shard.restore(start)
    streams = stream_keys([robot_seed(SEED, robot) for robot in range(lost_packets.ROWS)], Stream.PACKETS)
    oldest = np.zeros(WIDTH)
    for first in range(0, len(streams), WIDTH):
        pushed.shard.restore(start)
        sensors.use_packets(streams[first : first + WIDTH])
        oldest = np.maximum(oldest, ages(pushed, 90)[at].max(axis=1))
    np.testing.assert_array_equal(chosen[at, np.arange(WIDTH)], oldest)


@pytest.mark.parametrize("mode", [ControlMode.POSITION, ControlMode.VELOCITY])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_gains_reach_the_bounds_of_a_contract_and_stay_inside(mode, share):
    at = weights(stiffness=(share,) * SPEC.n, damping_of_drive=(share,) * SPEC.n)
    found = gains_of(at, SPEC, mode)
    check_contract(attack_contract(SPEC, mode, found), SPEC, "gains")
    extremes = dict(zip((0.0, 1.0), extreme_gains(SPEC, mode).values(), strict=True))
    if share in extremes:
        np.testing.assert_allclose(found, extremes[share], rtol=1e-12)


def test_drives_keep_their_own_gains_in_torque_mode_and_those_that_are_given():
    assert gains_of(weights(), SPEC, ControlMode.TORQUE) is None
    assert gains_of(ADVERSARIES["push"].first(SPEC.n), SPEC, ControlMode.POSITION) is None
    given = TrainedGains((1.0,) * SPEC.n, (2.0,) * SPEC.n)
    setting = Setting(robot=SPEC.folder, mode=ControlMode.POSITION, gains=given)
    assert setting.contract_gains(weights(), SPEC) == given


@pytest.mark.slow
@pytest.mark.parametrize("mode", ControlMode)
@pytest.mark.parametrize("name", NAMES)
def test_trial_is_that_of_the_file_which_its_bundle_replays(name, mode, tmp_path):
    rng = np.random.default_rng(3)
    adversary = next(each for each in pushed_arms(mode, gains=False) if each.name == name)
    shares = rng.random((WIDTH, len(adversary.shares(adversary.first(SPEC.n)))))
    rows = tuple(adversary.weights(each, SPEC.n) | {"refused_s": (0.2,)} for each in shares)
    setting, monitor = Setting(robot=SPEC.folder, mode=mode), "velocity"
    arena = Arena(setting, SEED, ADVERSARIES[name].effect)
    outcome = arena.try_block(Block(name, rows, SEED))
    candidate = Candidate(name, rows[2], SEED)
    alone = arena.try_candidate(candidate)
    assert all((ratios[2] == alone.worst[key][2]).all() for key, ratios in outcome.worst.items())
    assert len({*outcome.worst[monitor].tolist()}) > WIDTH // 4, "policies differ"
    written = write_peak(setting, monitor, candidate, tmp_path / "worst")
    assert written.ratio == alone.worst[monitor].max()
    replay = Replay(tmp_path / "worst" / written.name)
    assert mismatch(replay, replay.run()) == ""
