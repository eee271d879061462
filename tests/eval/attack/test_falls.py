"""Falls in an attack: what a robot does after its fall does not count, but for how the fall is noticed."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.attack.adversaries import ADVERSARIES
from eval.attack.arena import Arena, Setting
from eval.attack.candidate import Block
from eval.attack.falls import OF_FALLS, Falls
from eval.shard.job import WIDTH
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC
from support.quadruped import QUADRUPED

SEED = 7


@pytest.mark.slow
def test_only_how_a_fall_is_noticed_counts_after_it():
    arena = Arena(Setting(robot=QUADRUPED.folder, mode=ControlMode.POSITION), SEED)
    first = ADVERSARIES["push"].first(QUADRUPED.n)
    outcome = arena.try_block(Block("push", (first,) * WIDTH, SEED))
    judged = arena._shard.judge.counts()
    whole = {m.name: judged.worst[:, judged.columns(m.name)].max(axis=1) for m in judged.monitors}
    fell = outcome.worst["tilt"] > 1.0
    assert fell.any()
    for name, ratios in outcome.worst.items():
        assert (ratios <= whole[name]).all()
        np.testing.assert_array_equal(ratios[~fell], whole[name][~fell])
        if name in OF_FALLS:
            np.testing.assert_array_equal(ratios, whole[name])
    assert (outcome.worst["tilt"][fell] < whole["tilt"][fell]).all()
    assert (outcome.worst["powered_fallen"] <= 1.0).all()


def test_a_robot_on_a_mount_does_not_fall():
    arena = Arena(Setting(robot=SPEC.folder, mode=ControlMode.POSITION), SEED)
    arena._shard.tick()
    falls = Falls(SPEC, WIDTH)
    assert not falls.step(arena._shard.truth, arena._shard.runtime.supervisor.powered).any()
    assert not falls.fallen.any()
