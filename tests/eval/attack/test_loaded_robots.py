"""Extra loads of drawn robots, and hot motors."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.attack.arena import Setting, write_job
from eval.attack.candidate import Candidate
from eval.attack.loaded_robots import extra_load, heat, sag
from eval.replay.bundle import POLICY
from eval.shard.job import WIDTH
from eval.shard.shard import Shard
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.models.levers import joint_levers
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.spec import load_robot

ARM = load_robot("arm6")


def test_extra_load_is_torque_of_mass_payload_and_push_at_full_reach():
    plain = median_draw(load_distributions(ARM), ARM, 1).replaced(
        {"links.mass": 1.0, "payload.mass_kg": 0.0, "push.force_n": 0.0}
    )
    assert extra_load(ARM, plain) == pytest.approx(0.0)
    pushed = extra_load(ARM, plain.replaced({"push.force_n": 30.0}))
    assert pushed == pytest.approx(30.0 * 0.2393 / 28.0)  # wrist_1, 0.0997 + 0.0996 + 0.04 m from the tool
    carrying = extra_load(ARM, plain.replaced({"payload.mass_kg": 30.0 / 9.81}))
    np.testing.assert_allclose(carrying, pushed)
    heavy = extra_load(ARM, plain.replaced({"links.mass": 1.2}))
    assert 0.05 < heavy < 0.15


def test_sag_is_what_soft_drives_yield_at_the_end_of_the_arm():
    plain = median_draw(load_distributions(ARM), ARM, 1).replaced(
        {"links.mass": 1.0, "payload.mass_kg": 0.0, "push.force_n": 0.0, "drives.kp": 0.8}
    )
    assert sag(ARM, plain) == pytest.approx(0.0)
    push = sag(ARM, plain.replaced({"push.force_n": 30.0}))
    lever_of_tool, lever_of_shapes = 0.2393, joint_levers(ARM)
    wrist = 30.0 * lever_of_tool / (0.8 * drive_gains(ARM).kp[3]) * lever_of_shapes[3]
    assert push > 2.0 * wrist > 0.0
    assert sag(ARM, plain.replaced({"push.force_n": 30.0, "drives.kp": 0.4})) == pytest.approx(2.0 * push)


def test_hot_motors_are_halfway_to_the_end_of_their_work_for_plant_and_runtime(tmp_path):
    setting = Setting(robot=ARM.folder, mode=ControlMode.POSITION, loaded=False)
    shard = Shard(write_job(setting, ARM, Candidate("", {}, 3), tmp_path / POLICY))
    hot = np.arange(WIDTH) % 2 == 0
    cold_c = shard.robot.truth().winding_c[1].copy()
    heat(shard, hot & (np.arange(WIDTH) < 8))
    heat(shard, hot & (np.arange(WIDTH) >= 8))
    for _ in range(20):
        shard.tick()
    truth, state = shard.truth, shard.runtime.state
    np.testing.assert_allclose(truth.winding_c[hot], 95.0, atol=0.5)
    np.testing.assert_allclose(truth.housing_c[hot], 80.0, atol=0.5)
    np.testing.assert_allclose(truth.winding_c[1], cold_c, atol=0.5)
    np.testing.assert_allclose(state.winding_c[hot], 95.0, atol=3.0)
    foldback = shard.runtime.estimator.windings.foldback.level
    assert ((foldback[hot] > 0.4) & (foldback[hot] < 0.9)).all()
    assert not foldback[~hot].any()
