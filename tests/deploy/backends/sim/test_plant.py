from copy import copy

import numpy as np
import pytest

from support.arm6 import SPEC
from support.deploy.plants import BUSY, DT, HOME, PLANT_MODEL, N, command, drawn, exact

mujoco = pytest.importorskip("mujoco")
load_mujoco = pytest.importorskip("robots.models.mujoco_model").load_mujoco


def holding_torque(spec=SPEC, q=HOME):
    model = load_mujoco(spec)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    return data.qfrc_bias.copy()


def test_rests_at_home_with_brakes_on():
    plant = drawn(4)
    truth = plant.truth(0.0)
    np.testing.assert_array_equal(truth.q, np.tile(HOME, (4, 1)))
    assert plant.braked.all()
    assert truth.valid.all()
    assert not truth.self_collision.any()


def test_brakes_hold_whatever_the_command():
    plant, wild = drawn(4), np.random.default_rng(0)
    for _ in range(200):
        plant.step(command(wild.normal(0, 1, (4, N)), 2.0, 50.0, powered=False))
    assert np.abs(plant.q - HOME).max() < 0.01
    assert np.abs(plant.qd).max() < 0.01


def test_a_closed_brake_takes_no_current_and_warms_nothing():
    plant = drawn(3)
    for _ in range(400):
        plant.step(command(np.tile(HOME, (3, 1))))
    assert (np.abs(plant.current) > 0.5).any(axis=1).all()
    for k in range(60):
        plant.step(command(np.tile(HOME + 0.8 * k * DT, (3, 1)), 0.8))
    rise = plant.truth(0.0).winding_c - plant.housing
    for _ in range(2000):
        plant.step(command(np.tile(HOME, (3, 1)), powered=False))  # in the midst of a motion
        assert not plant.current.any()
    cooled = plant.truth(0.0).winding_c - plant.housing
    seconds = plant.windings.to_housing * plant.windings.capacity
    np.testing.assert_allclose(cooled, rise * np.exp(-2000 * DT / seconds), atol=0.2)
    plant.step(command(np.tile(HOME, (3, 1))))
    assert (np.abs(plant.current) > 0.5).any(axis=1).all()


def test_brakes_close_on_the_pose_they_find():
    plant = exact(2)
    for k in range(60):
        plant.step(command(np.tile(HOME + 0.5 * k * DT, (2, 1)), 0.5))
    closed = plant.kinematics.motor_q.copy()
    only = np.array([True, False])
    for k in range(60, 160):
        plant.step(command(np.tile(HOME + 0.5 * k * DT, (2, 1)), 0.5, powered=~only))
    assert np.abs(plant.q[0] - closed[0]).max() < 0.02
    np.testing.assert_allclose(plant.q[1], HOME + 0.5 * 160 * DT, atol=0.02)
    np.testing.assert_array_equal(plant.drives.held[0], closed[0])


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_drive_current_is_limited_to_its_share(share):
    """A torque that is far too large for it, on one joint; its neighbour has all of its current."""
    plant, tau, current = exact(), np.zeros(N), np.ones(N)
    tau[5], tau[4], current[5] = 1000.0, 1000.0, share
    for _ in range(2):
        plant.step(command(HOME, tau=tau, current=current))
    most = 28.0 / 101 / 0.1
    assert plant.current[0, 5] == pytest.approx(share * most, rel=0.02)
    assert plant.current[0, 4] == pytest.approx(most, rel=0.02)


def test_category_0_needs_no_command():
    plant = exact(2, {"joints.backlash_rad": 0.004})
    for _ in range(40):
        plant.step(command(np.tile(HOME, (2, 1))))
    assert not plant.braked.any()
    plant.brake(np.array([False, True]))
    assert plant.braked.tolist() == [False, True]
    motor = plant.readings["encoder"][1]  # brakes sit where the motor is
    np.testing.assert_array_equal(plant.drives.held[1], motor)
    assert np.abs(motor - plant.q[1]).max() > 0.001


@pytest.mark.parametrize("speed", [-1.0, 0.3])
def test_drive_tracks_a_ramp_within_10_mrad(speed):
    """Every draw of the training range, every joint, with the nominal model's feed-forward of gravity only."""
    robots, start = 16, np.array([0.0, -1.3, 1.4, -1.4, -1.5, 0.0])
    plant = drawn(robots)
    plant.reset(np.ones(robots, dtype=bool), np.tile(start, (robots, 1)))
    q, qd, worst = start.copy(), np.zeros(N), 0.0
    for k in range(120):
        qd[:] = speed * min(1.0, k * DT / 0.3)
        q += qd * DT
        plant.step(command(np.tile(q, (robots, 1)), qd, holding_torque(q=q)))
        worst = max(worst, np.abs(plant.q - q).max())
    assert worst < 0.010
    assert np.abs(plant.q - start).min() > 0.05


def test_setpoints_are_interpolated_linearly():
    """As MuJoCo alone goes when it is led there step by step; taken at once, each would saturate the motor."""
    plant, model = exact(), copy(PLANT_MODEL.model)
    data, gear = mujoco.MjData(model), model.actuator_gear[:, 0]
    joints, play = model.jnt_qposadr[PLANT_MODEL.joints], model.jnt_qposadr[PLANT_MODEL.backlash]
    model.jnt_range[PLANT_MODEL.backlash] = model.tendon_stiffness[:] = 0.0
    data.qpos[joints] = HOME
    last, qd, worst = np.array((HOME, HOME * 0, HOME * 0)), np.zeros(N), 0.0
    for k in range(60):
        qd[0] = 2.5 * min(1.0, k / 40)
        now = np.array((last[0] + qd * DT, qd, holding_torque()))
        plant.step(command(now[0], now[1], now[2]))
        for part in np.arange(1, 6) / 5:
            q, v, tau = last + part * (now - last)
            data.ctrl[:] = np.stack((q * gear, v * gear, tau / gear), axis=1).ravel()
            mujoco.mj_step(model, data)
        last = now
        np.testing.assert_allclose(plant.q[0], data.qpos[joints] + data.qpos[play], rtol=0, atol=1e-6)
        worst = max(worst, np.abs(plant.truth(0.0).tau[0, 0]))
    assert worst < 75.0


def assert_same(one, other, rows=slice(None)):
    """Robots `rows` of one plant, and all of another: not one bit apart."""
    expected, found = one.save(), other.save()
    assert expected.keys() == found.keys()
    for name in found:
        of_all = expected[name] if name == "tick" else expected[name][rows]
        np.testing.assert_array_equal(found[name], of_all, err_msg=name)
    for kind in SPEC.channels.keys() - {"goal"}:
        np.testing.assert_array_equal(other.readings[kind], one.readings[kind][rows], err_msg=kind)
    for name, values in one.truth(0.0)._asdict().items():
        if name not in ("t", "base", "allowed_contact_n"):
            np.testing.assert_array_equal(getattr(other.truth(0.0), name), values[rows], err_msg=name)


def wild(robots, ticks, seed=0):
    return HOME + np.cumsum(np.random.default_rng(seed).normal(0, 0.01, (ticks, robots, N)), axis=0)


def test_threads_do_not_change_a_bit():
    one, many = drawn(6, BUSY), drawn(6, BUSY, threads=2)
    for q in wild(6, 250):
        one.step(command(q))
        many.step(command(q))
    assert_same(one, many)


def test_robot_alone_equals_the_same_robot_in_a_group():
    group, alone = drawn(5, BUSY), drawn(5, BUSY, rows=slice(2, 3))
    for q in wild(5, 450):
        group.step(command(q))
        alone.step(command(q[2:3]))
    assert group.disturbances["payload"].phase[2] > 1
    assert group.disturbances["pushes"].phase[2] > 1
    assert group.wear.life[2].min() > 0
    assert_same(group, alone, slice(2, 3))


@pytest.mark.slow
def test_saved_and_restored_goes_on_bit_for_bit():
    """Into a plant that has lived another life, in which one robot diverged; nothing of it remains."""
    path = wild(3, 700)
    one, other = drawn(3, BUSY), drawn(3, BUSY)
    for k in range(430):
        one.step(command(path[k], tau=20.0))
        other.step(command(path[-k - 1], tau=-20.0, powered=k < 100))
    other.batch.bind("qvel")[1] = np.nan
    for k in range(30):
        other.step(command(path[k]))
    assert not other.valid.all()
    assert (other.disturbances["payload"].on != one.disturbances["payload"].on).any()
    other.restore(one.save())
    for kind in SPEC.channels.keys() - {"goal"}:
        np.testing.assert_array_equal(other.readings[kind], one.readings[kind], err_msg=kind)
    for k in range(430, 700):
        one.step(command(path[k]))
        other.step(command(path[k]))
        assert_same(one, other)
    assert one.disturbances["pushes"].phase.max() > 2
    assert other.valid.all()


def test_reset_of_a_subset_leaves_the_others_alone():
    plant, twin = drawn(3, BUSY), drawn(3, BUSY)
    for k in range(230):
        for each in (plant, twin):
            each.step(command(np.tile(HOME + 0.1 * k * DT, (3, 1)), 0.1, 30.0))
    pose, one = np.tile(HOME - 0.2, (3, 1)), np.array([False, True, False])
    assert (plant.wear.worn().friction > 1.0).all()
    plant.reset(one, pose)
    np.testing.assert_array_equal(plant.q[1], pose[1])
    np.testing.assert_array_equal(plant.qd[1], 0.0)
    np.testing.assert_array_equal(plant.truth(0.0).winding_c[1], plant.housing[1])
    np.testing.assert_array_equal(plant.wear.worn().friction[1], 1.0)
    np.testing.assert_allclose(plant.readings["current"][1], 0.0, atol=1e-6)
    for _ in range(250):
        for each in (plant, twin):
            each.step(command(np.tile(HOME, (3, 1)), powered=~one))
    for name, expected in twin.save().items():
        np.testing.assert_array_equal(plant.save()[name][::2], expected[::2], err_msg=name)
    assert np.abs(plant.q[1] - pose[1]).max() < 0.01


def test_contact_with_itself_and_with_the_table_is_true():
    plant = exact(3)
    folded, down = HOME.copy(), HOME.copy()
    folded[2], folded[3] = 3.0, 1.0
    down[1], down[2] = -0.05, 0.3
    plant.reset(np.ones(3, dtype=bool), np.stack((HOME, folded, down)))
    plant.step(command(plant.q.copy()))
    truth = plant.truth(0.0)
    assert truth.self_collision.tolist() == [False, True, True]
    assert truth.contact_n[0] == 0.0
    assert (truth.contact_n[1:] > 1.0).all()


def test_contact_force_is_the_strongest_contacts_normal_one():
    """As MuJoCo's own function says of the same state, on the one robot whose arm lies on the table."""
    plant, down = exact(1), HOME.copy()
    down[1], down[2] = -0.05, 0.3
    plant.reset(np.ones(1, dtype=bool), down[None])
    data, model = plant.batch.get_data(0), plant.batch.get_model(0)
    mujoco.mj_forward(model, data)
    forces = np.zeros((data.ncon, 6))
    for contact, force in enumerate(forces):
        mujoco.mj_contactForce(model, data, contact, force)
    strongest = np.linalg.norm(forces[:, :3], axis=1).argmax()
    assert plant.truth(0.0).contact_n[0] == pytest.approx(forces[strongest, 0], rel=1e-6)
    assert forces[strongest, 0] > 1.0


def test_tool_position_equals_forward_kinematics():
    """One physics step late, as the record says: at 1 m/s that is a millimetre."""
    plant = drawn(2)
    for k in range(100):
        plant.step(command(np.tile(HOME + 0.4 * k * DT, (2, 1)), 0.4))
    model, data = plant.batch.get_model(1), plant.batch.get_data(1)
    mujoco.mj_kinematics(model, data)
    late = np.linalg.norm(plant.tool[1] - data.site("tool").xpos)
    speed = np.linalg.norm(plant.tool_velocity[1])
    assert speed > 0.1
    assert late < 1.5 * speed / SPEC.rates.physics_hz
