"""Trials on simulated robots: reproducible, and of robots as draws.toml has them."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

import eval.margins.trial as module
from deploy.policy.actor import Actor
from deploy.reasons import Reason
from eval.attack import loaded_robots
from eval.attack.arena import Setting
from eval.attack.loaded_robots import CHOICE, DISTURBED, extra_load
from eval.attack.throws import throws
from eval.margins.aimed_pushes import NOBODY, Moment
from eval.margins.trial import AIMED, MOMENTS, OF_TOOL, Trial, aims, draw_robots, make_shard, run
from eval.shard.job import WIDTH
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from robots.spec import load_robot

PLANAR = load_robot("planar3")
BRAKED = MOMENTS == Moment.BRAKING
POSITION = Setting(robot=PLANAR.folder, mode=ControlMode.POSITION)


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Trials of 0.8 s in operation."""
    monkeypatch.setattr(module, "TRIAL_S", 1.0)


def test_trials_are_reproducible_and_policies_differ():
    trial = Trial(POSITION, "bang_bang", 3, False)
    first, second = run(trial), run(trial)
    assert first.diverged == 0
    for name, excess in first.excess.items():
        np.testing.assert_array_equal(excess, second.excess[name])
    assert (first.excess["angle"] > 0.0).all()
    assert len(np.unique(first.excess["angle"])) == WIDTH


def test_corners_have_the_least_or_the_most_and_other_robots_what_they_drew():
    drawn, corners = (draw_robots(PLANAR, 5, corners=which) for which in (False, True))
    for name, _, span in load_distributions(PLANAR).spans():
        if name.startswith(("sensors.", "climate.", "wear.")):
            np.testing.assert_array_equal(corners[name], drawn[name])
        elif not name.startswith(("push.every", "payload.carried", "payload.free")):
            assert np.isin(corners[name], (span.low, span.high)).all(), name
            assert ((drawn[name] >= span.low) & (drawn[name] <= span.high)).all()
    assert set(np.unique(drawn["payload.carried_s"] > 1.0)) == {True, False}
    for name in DISTURBED:
        np.testing.assert_array_equal(corners[name], drawn[name])


def test_of_the_first_half_every_second_robot_is_one_of_those_with_the_most_load():
    load = extra_load(PLANAR, draw_robots(PLANAR, 5, corners=False))[:AIMED]
    assert load[1::2].min() > np.median(load[::2])


def test_robots_of_the_other_half_are_those_that_a_push_affects_most():
    seed = 4
    seeds = [robot_seed(seed, robot) for robot in range(CHOICE * WIDTH)]
    speed, torque, _ = throws(PLANAR, draw(load_distributions(PLANAR), PLANAR, seeds))
    robots = draw_robots(PLANAR, seed, corners=False)
    assert (robots["push.every_s"][AIMED:] > 1e6).all()
    found = throws(PLANAR, robots)
    most = np.sort(torque.max(axis=(1, 2)))[::-1]
    assert found.torque[AIMED:][BRAKED].max(axis=(1, 2)).max() == most[0]
    fast = AIMED + np.flatnonzero(~BRAKED)
    for robot, joint in zip(fast, aims(PLANAR, robots, seed).joints[fast], strict=True):
        assert found.speed[robot, joint].max() >= np.sort(speed[:, joint].max(axis=1))[-(WIDTH - AIMED)]


def test_tools_are_pushed_of_robots_whose_throws_add_up_to_most():
    arm, seed = load_robot("arm6"), 4
    seeds = [robot_seed(seed, robot) for robot in range(CHOICE * WIDTH)]
    most = np.sort(throws(arm, draw(load_distributions(arm), arm, seeds)).tool)[::-1]
    chosen = throws(arm, draw_robots(arm, seed, corners=False)).tool[AIMED:][OF_TOOL]
    assert chosen[0] == most[0]
    assert (chosen >= most[WIDTH - AIMED]).all()


def test_aims_are_joints_in_turn_and_the_links_that_throw_them_most():
    arm, aimed = load_robot("arm6"), set()
    for seed in range(arm.n):
        robots = draw_robots(arm, seed, corners=False)
        speed, torque, _ = throws(arm, robots)
        chosen = aims(arm, robots, seed)
        assert (chosen.joints[:AIMED] == NOBODY).all()
        assert (chosen.moments[AIMED:] == MOMENTS).all()
        tools, braked = chosen.joints == arm.n, chosen.moments == Moment.BRAKING
        assert (AIMED + np.flatnonzero(OF_TOOL)).tolist() == np.flatnonzero(tools).tolist()
        assert (chosen.links[tools] == arm.n - 1).all()
        for robot in AIMED + np.flatnonzero(~tools[AIMED:]):
            effect = (torque if braked[robot] else speed)[robot]
            assert effect[chosen.joints[robot], chosen.links[robot]] == effect[chosen.joints[robot]].max()
        for robot in np.flatnonzero(braked):
            assert torque[robot, chosen.joints[robot]].max() == torque[robot].max()
        aimed |= set(chosen.joints[AIMED:][~braked[AIMED:]].tolist())
    assert aimed == {*range(arm.n + 1)}


def test_robots_of_the_other_half_are_pushed(monkeypatch):
    pushed, seen = [], module.AimedPushes.step

    def step(self, *values):
        seen(self, *values)
        pushed.append(self.on.copy())

    monkeypatch.setattr(module.AimedPushes, "step", step)
    monkeypatch.setattr(module, "TRIAL_S", 2.0)
    run(Trial(POSITION, "bang_bang", 3, False))
    ever = np.any(pushed, axis=0)
    assert ever[AIMED:][MOMENTS != Moment.STOPPING].all()
    assert not ever[:AIMED].any()


def test_pushes_are_told_the_tick_in_which_a_stop_begins(monkeypatch):
    told, seen, modes = [], module.AimedPushes.step, []

    def step(self, planned, q, qd, stops):
        seen(self, planned, q, qd, stops)
        told.append(stops.copy())

    def ticked(self, run=module.Shard.tick):
        before = self.runtime.supervisor.running
        if self.runtime.ticks == 150:
            self.runtime.stop(Reason.OPERATOR)
        run(self)
        modes.append(before & ~self.runtime.supervisor.running)

    monkeypatch.setattr(module.AimedPushes, "step", step)
    monkeypatch.setattr(module.Shard, "tick", ticked)
    run(Trial(POSITION, "bang_bang", 3, False))
    np.testing.assert_array_equal(told, modes)
    assert np.flatnonzero(np.any(told, axis=1)).tolist() == [150]


class Script(Actor):
    """Recorded actions, the same for all robots."""

    def __init__(self, contract, actions):
        self.contract, self.digest, self.actions, self.place = contract, "", actions, 0

    def step(self, observation):
        self.place += 1
        return np.tile(self.actions[self.place - 1], (len(observation), 1))

    def reset(self, ids):
        pass

    def resize(self, robots):
        pass


@pytest.mark.parametrize(("mode", "same"), [(ControlMode.POSITION, True), (ControlMode.TORQUE, False)])
def test_noise_decides_what_is_sent_in_torque_mode_only(mode, same, monkeypatch):
    """But for the pose at arming, where a robot is by its own estimate, and the speed that hot motors leave."""
    monkeypatch.setattr(loaded_robots, "HOT", 0.0)
    setting, robots = Setting(robot=PLANAR.folder, mode=mode), draw_robots(PLANAR, 5, corners=False)
    one = Draw({name: np.repeat(x[:1], WIDTH, axis=0) for name, x in robots.items()})
    shard = make_shard(setting, one.replaced({"push.every_s": 1e4, "payload.carried_s": 1e4}), 9)
    steps = np.sin(np.arange(200)[:, None] / 20.0) * [0.4, -0.4, 0.4]
    shard.set_policy(
        Script(shard.runtime.contract, (steps + PLANAR.joint_array("q_home")).astype(np.float32))
    )
    apart = 0.0
    for _ in range(200):
        shard.tick()
        apart = max(apart, np.ptp(shard.runtime.setpoint.qd, axis=0).max())
    assert (apart < 0.05) == same
    assert shard.runtime.supervisor.running.all() == same


def test_error_of_the_estimated_speed_is_larger_in_torque_mode():
    """Drives hold an angle that is known; torques do not."""
    errors = {
        mode: run(Trial(Setting(robot=PLANAR.folder, mode=mode), "push", 3, False)).estimate_error
        for mode in (ControlMode.POSITION, ControlMode.TORQUE)
    }
    assert (errors[ControlMode.TORQUE][1] > errors[ControlMode.POSITION][1]).all()
    assert (errors[ControlMode.TORQUE] < [[0.01], [1.0]]).all()
