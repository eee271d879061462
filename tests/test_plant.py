from dataclasses import fields, replace

import numpy as np
import pytest
from test_spec import SPEC, copy_of_arm

from deploy.state import Command
from robots.draws import Draw, draw, load_distributions
from robots.motor import MotorHeat, temperatures
from robots.randomness import robot_seed
from robots.spec import load_robot

mujoco = pytest.importorskip("mujoco")
Plant = pytest.importorskip("deploy.backends.sim.plant").Plant
load_mujoco = pytest.importorskip("robots.model_mujoco").load_mujoco

N, DT = SPEC.n, SPEC.dt
HOME = SPEC.joint_array("q_home")


def drawn(robots, seed=1, **changes):
    d = draw(load_distributions(SPEC), N, [robot_seed(seed, robot) for robot in range(robots)])
    return replace(d, **{name: np.full_like(getattr(d, name), value) for name, value in changes.items()})


def exact(robots=1, **changes):
    """Robots without a lie, but those that are named."""
    factors = {field.name: 1.0 for field in fields(Draw)}
    plain = {**factors, "noise_rad": 0.0, "delay_s": 0.0, "loss": 0.0, "ambient_c": 25.0, "warm_start_k": 0.0}
    return drawn(robots, **{**plain, **changes})


def command(q, qd=0.0, tau=0.0, powered=True, current=1.0):
    q = np.atleast_2d(q)
    return Command(
        q=q,
        qd=np.broadcast_to(qd, q.shape),
        tau=np.broadcast_to(tau, q.shape),
        powered=np.broadcast_to(powered, len(q)),
        current=np.broadcast_to(current, q.shape),
    )


def holding_torque(spec=SPEC, q=HOME):
    model = load_mujoco(spec)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    return data.qfrc_bias.copy()


def test_rests_at_home_with_brakes_on():
    plant = Plant(SPEC, drawn(4))
    truth = plant.truth(0.0)
    np.testing.assert_array_equal(truth.q, np.tile(HOME, (4, 1)))
    assert plant.braked.all()
    assert truth.valid.all()
    assert not truth.self_collision.any()


def test_brakes_hold_whatever_the_command():
    plant, wild = Plant(SPEC, drawn(4)), np.random.default_rng(0)
    for _ in range(200):
        plant.step(command(wild.normal(0, 1, (4, N)), 2.0, 50.0, powered=False))
    assert np.abs(plant.q - HOME).max() < 0.01
    assert np.abs(plant.qd).max() < 0.01


def test_brakes_close_on_the_pose_they_find():
    plant = Plant(SPEC, exact(2))
    for k in range(60):
        plant.step(command(np.tile(HOME + 0.5 * k * DT, (2, 1)), 0.5))
    closed = plant.q.copy()
    only = np.array([True, False])
    for k in range(60, 160):
        plant.step(command(np.tile(HOME + 0.5 * k * DT, (2, 1)), 0.5, powered=~only))
    assert np.abs(plant.q[0] - closed[0]).max() < 0.02
    np.testing.assert_allclose(plant.q[1], HOME + 0.5 * 160 * DT, atol=0.02)
    np.testing.assert_array_equal(plant.held[0], closed[0])


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_a_drive_keeps_to_its_share_of_current(share):
    """A torque that is far too large for it, on one joint; its neighbour has all of its current."""
    plant, tau, current = Plant(SPEC, exact()), np.zeros(N), np.ones(N)
    tau[5], tau[4], current[5] = 1000.0, 1000.0, share
    for _ in range(2):
        plant.step(command(HOME, tau=tau, current=current))
    most = 28.0 / 101 / 0.1
    assert plant.current[0, 5] == pytest.approx(share * most, rel=0.02)
    assert plant.current[0, 4] == pytest.approx(most, rel=0.02)


def test_category_0_needs_no_command():
    plant = Plant(SPEC, exact(2))
    plant.step(command(np.tile(HOME, (2, 1))))
    assert not plant.braked.any()
    plant.brake(np.array([False, True]))
    assert plant.braked.tolist() == [False, True]


@pytest.mark.parametrize("speed", [-1.0, 0.3])
def test_drive_tracks_a_ramp_within_10_mrad(speed):
    """Every draw of the training range, every joint, with the nominal model's feed-forward of gravity only."""
    robots, start = 16, np.array([0.0, -1.3, 1.4, -1.4, -1.5, 0.0])
    plant = Plant(SPEC, drawn(robots))
    plant.reset(np.ones(robots, dtype=bool), np.tile(start, (robots, 1)))
    q, qd, worst = start.copy(), np.zeros(N), 0.0
    for k in range(120):
        qd[:] = speed * min(1.0, k * DT / 0.3)
        q += qd * DT
        plant.step(command(np.tile(q, (robots, 1)), qd, holding_torque(q=q)))
        worst = max(worst, np.abs(plant.q - q).max())
    assert worst < 0.010
    assert np.abs(plant.q - start).min() > 0.05


def test_drives_go_in_straight_lines_from_setpoint_to_setpoint():
    """As MuJoCo alone goes when it is led there step by step; taken at once, each would saturate the motor."""
    plant, model = Plant(SPEC, exact(mass=1.0)), load_mujoco(SPEC)
    data, gear = mujoco.MjData(model), model.actuator_gear[:, 0]
    data.qpos[:] = HOME
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
        np.testing.assert_allclose(plant.q[0], data.qpos, rtol=0, atol=1e-6)
        worst = max(worst, np.abs(plant.truth(0.0).tau[0, 0]))
    assert worst < 75.0


def test_a_simulation_that_is_warned_of_anything_no_longer_counts(tmp_path):
    """It stops in the middle of a rollout, so it lives less than the others: here for want of room for contacts."""
    small = [(r"<option timestep", '<size memory="8K"/><option timestep')]
    plant, folded = Plant(load_robot(copy_of_arm(tmp_path, xml=small)), exact(2)), HOME.copy()
    folded[2], folded[3] = 3.0, 1.0
    plant.reset(np.array([False, True]), np.tile(folded, (2, 1)))
    plant.step(command(plant.q.copy()))
    assert plant.truth(0.0).valid.tolist() == [True, False]


def test_mass_and_inertia_scale_together_and_everything_derived_follows():
    plant, links = Plant(SPEC, drawn(3)), slice(2, None)
    batch, model = plant.batch, load_mujoco(SPEC)
    for i in range(3):
        own = batch.get_model(i)
        ratio = own.body_mass[links] / model.body_mass[links]
        assert not np.allclose(ratio, 1.0, atol=1e-3)
        np.testing.assert_allclose(
            own.body_inertia[links] / model.body_inertia[links], ratio[:, None] * np.ones(3)
        )
        fresh = mujoco.MjModel.from_xml_path(str(SPEC.model_path))
        fresh.body_mass[:], fresh.body_inertia[:] = own.body_mass, own.body_inertia
        fresh.dof_armature[:] = own.dof_armature
        mujoco.mj_setConst(fresh, mujoco.MjData(fresh))
        np.testing.assert_allclose(own.body_invweight0, fresh.body_invweight0, rtol=1e-12)
        np.testing.assert_allclose(own.dof_M0, fresh.dof_M0, rtol=1e-12)
        np.testing.assert_allclose(own.body_subtreemass, fresh.body_subtreemass, rtol=1e-12)
        assert not np.allclose(own.body_invweight0[links], model.body_invweight0[links], rtol=1e-3)


FACTORS = ("mass", "friction", "damping", "armature", "kp", "kd", "torque_constant", "resistance")


@pytest.mark.parametrize("name", FACTORS)
def test_every_factor_of_a_draw_changes_the_motion(name):
    """A parameter that is drawn but not felt would be a lie about the evidence."""
    plants = [Plant(SPEC, exact(**changes)) for changes in ({}, {name: 1.2})]
    paths = []
    for plant in plants:
        path = []
        for k in range(80):
            goal = HOME + 0.3 * np.sin(8 * k * DT)
            plant.step(command(goal, 2.4 * np.cos(8 * k * DT)))
            path.append(np.concatenate((plant.q[0], plant._rise[0])))
        paths.append(np.array(path))
    assert np.abs(paths[0] - paths[1]).max() > 1e-6


def test_no_plant_equals_the_model_that_deploy_computes_with():
    model, plant = load_mujoco(SPEC), Plant(SPEC, drawn(8))
    for i in range(8):
        own = plant.batch.get_model(i)
        assert (own.body_mass[2:] != model.body_mass[2:]).all()
        assert (own.body_inertia[2:] != model.body_inertia[2:]).all()
        for name in ("dof_frictionloss", "dof_damping", "dof_armature"):
            assert (getattr(own, name) != getattr(model, name)).all()
        places = [0, 1, 4, 6]
        assert (own.actuator_gainprm[:, places] != model.actuator_gainprm[:, places]).all()
        assert plant.truth(0.0).winding_c[i].min() > 15.0


@pytest.mark.parametrize("threads", [2])
def test_threads_do_not_change_a_bit(threads):
    one, many, rng = Plant(SPEC, drawn(6)), Plant(SPEC, drawn(6), threads=threads), np.random.default_rng(0)
    for _ in range(50):
        q = HOME + rng.normal(0, 0.05, (6, N))
        one.step(command(q))
        many.step(command(q))
    np.testing.assert_array_equal(one.rows, many.rows)
    np.testing.assert_array_equal(one.housing, many.housing)


def test_a_robot_alone_is_the_robot_in_a_group():
    whole = drawn(5)
    third = Draw(**{field.name: getattr(whole, field.name)[2:3] for field in fields(Draw)})
    group, alone, rng = Plant(SPEC, whole), Plant(SPEC, third), np.random.default_rng(1)
    for _ in range(60):
        q = HOME + rng.normal(0, 0.05, (5, N))
        group.step(command(q))
        alone.step(command(q[2:3]))
    np.testing.assert_array_equal(alone.rows[0], group.rows[2])
    np.testing.assert_array_equal(alone.housing[0], group.housing[2])


def test_saved_and_restored_goes_on_bit_for_bit():
    """Into a plant that has lived another life, in which one robot diverged."""
    rng = np.random.default_rng(2)
    path = HOME + np.cumsum(rng.normal(0, 0.01, (300, 3, N)), axis=0)
    one, other = Plant(SPEC, drawn(3)), Plant(SPEC, drawn(3))
    for k in range(150):
        one.step(command(path[k], tau=20.0))
        other.step(command(path[-k - 1], tau=-20.0, powered=k < 100))
    other.qd[1] = np.nan
    other.step(command(path[0]))
    assert not other.valid.all()
    other.restore(one.save())
    for k in range(150, 300):
        one.step(command(path[k]))
        other.step(command(path[k]))
        for name in ("q", "qd", "tau", "winding_c", "housing_c", "tool_position", "tool_velocity"):
            expected = getattr(one.truth(0.0), name)
            np.testing.assert_array_equal(
                getattr(other.truth(0.0), name), expected, err_msg=f"{name}, tick {k}"
            )
    assert other.valid.all()


def test_reset_of_a_subset_leaves_the_others_alone():
    plant, twin = Plant(SPEC, drawn(3)), Plant(SPEC, drawn(3))
    for k in range(100):
        for each in (plant, twin):
            each.step(command(np.tile(HOME + 0.3 * k * DT, (3, 1)), 0.3, 30.0))
    pose = HOME - 0.2
    plant.reset(np.array([False, True, False]), np.tile(pose, (3, 1)))
    np.testing.assert_array_equal(plant.q[1], pose)
    np.testing.assert_array_equal(plant.qd[1], 0.0)
    np.testing.assert_array_equal(plant.truth(0.0).winding_c[1], plant.housing[1])
    for _ in range(50):
        for each in (plant, twin):
            each.step(command(np.tile(HOME, (3, 1)), powered=np.array([True, False, True])))
    np.testing.assert_array_equal(plant.rows[[0, 2]], twin.rows[[0, 2]])
    assert np.abs(plant.q[1] - pose).max() < 0.01


@pytest.mark.parametrize("how", ["speed", "nan"])
def test_a_diverged_simulation_is_seen_and_stays_seen(how):
    plant, twin = Plant(SPEC, drawn(3)), Plant(SPEC, drawn(3))
    still = command(np.tile(HOME, (3, 1)))
    plant.qd[1] = 1e12 if how == "speed" else np.nan
    for _ in range(20):
        plant.step(still)
        twin.step(still)
        assert plant.truth(0.0).valid.tolist() == [True, False, True]
    np.testing.assert_array_equal(plant.rows[[0, 2]], twin.rows[[0, 2]])
    plant.reset(np.array([False, True, False]), np.tile(HOME, (3, 1)))
    for _ in range(20):
        plant.step(still)
    assert plant.truth(0.0).valid.all()
    assert np.abs(plant.q[1] - HOME).max() < 0.05


def test_contact_with_itself_and_with_the_table_is_true():
    plant = Plant(SPEC, exact(3))
    folded, down = HOME.copy(), HOME.copy()
    folded[2], folded[3] = 3.0, 1.0
    down[1], down[2] = -0.05, 0.3
    plant.reset(np.ones(3, dtype=bool), np.stack((HOME, folded, down)))
    plant.step(command(plant.q.copy()))
    assert plant.truth(0.0).self_collision.tolist() == [False, True, True]


def test_tool_is_where_forward_kinematics_says():
    """One physics step late, as the record says: at 1 m/s that is a millimetre."""
    plant, model = Plant(SPEC, drawn(2)), load_mujoco(SPEC)
    for k in range(100):
        plant.step(command(np.tile(HOME + 0.4 * k * DT, (2, 1)), 0.4))
    data = mujoco.MjData(model)
    data.qpos[:] = plant.q[1]
    mujoco.mj_kinematics(model, data)
    late = np.linalg.norm(plant.tool[1] - data.site("tool").xpos)
    speed = np.linalg.norm(plant.tool_velocity[1])
    assert speed > 0.1
    assert late < 1.5 * speed / SPEC.rates.physics_hz


# An RE40-like motor on the last joint: facts as in test_motor; 48 V, gear 101.
RE40 = MotorHeat(
    resistance=1.16,
    alpha=0.0039,
    reference_c=25.0,
    winding_to_housing=1.93,
    housing_to_ambient=4.65,
    winding_capacity=41.6 / 1.93,
    housing_capacity=1120.0 / 4.65,
)


def re40_arm(tmp_path, hz):
    folder = copy_of_arm(
        tmp_path,
        toml=[
            ("control_hz = 200", f"control_hz = {hz}"),
            ("physics_hz = 1000", f"physics_hz = {hz}"),
            ("housing_resistance_k_per_w = 3.0", f"housing_resistance_k_per_w = {RE40.housing_to_ambient}"),
            ("housing_capacity_j_per_k = 400.0", f"housing_capacity_j_per_k = {RE40.housing_capacity}"),
        ],
        xml=[
            (
                r'motorconst="0.1 0.1" resistance="3.0" saturation="0.27722772277227725"',
                'motorconst="0.0603 0.0603" resistance="1.16" saturation="9"',
            ),
            (r'thermal="2.0 12 0 0.0039 25 25"', f'thermal="1.93 {RE40.winding_capacity} 0 0.0039 25 25"'),
            # The joint is locked by its friction, and the drive does nothing but what it is told.
            (r'damping="1" frictionloss="0.8"', 'damping="1" frictionloss="100"'),
            (r'controller="0.4 0 0.012 0 0 48"', 'controller="0 0 0 0 0 480"'),
            (r'actuatorfrcrange="-28 28"', 'actuatorfrcrange="-900 900"'),
        ],
    )
    return load_robot(folder)


@pytest.mark.parametrize(("minutes", "hz"), [(1, 200), (10, 50), (60, 20)])
def test_heat_follows_the_closed_form_within_1_k(tmp_path, minutes, hz):
    """Two nodes, one in MuJoCo and one beside it, and R(T): a locked joint at a constant 3.12 A."""
    spec, ambient = re40_arm(tmp_path, hz), 25.0
    plant, dt = Plant(spec, exact(ambient_c=ambient)), spec.dt
    tau = np.zeros(N)
    for k in range(round(minutes * 60 / dt)):
        plant.step(command(HOME, tau=tau))
        # A commanded torque sags as the winding warms: the current is held from outside.
        if k % 20 == 0:
            measured = plant.current[0, 5]
            tau[5] = 3.12 * 0.0603 * 101 if k == 0 else tau[5] * 3.12 / measured
    assert plant.current[0, 5] == pytest.approx(3.12, rel=0.01)
    winding, housing = temperatures(RE40, 3.12, ambient, minutes * 60)
    truth = plant.truth(0.0)
    assert truth.winding_c[0, 5] == pytest.approx(winding, abs=1.0)
    assert truth.housing_c[0, 5] == pytest.approx(housing, abs=1.0)
    assert truth.winding_c[0, 4] == pytest.approx(ambient, abs=0.5)


def test_starts_as_warm_as_drawn_and_cools_to_its_room():
    plant = Plant(SPEC, exact(ambient_c=18.0, warm_start_k=12.0))
    truth = plant.truth(0.0)
    np.testing.assert_array_equal(truth.housing_c, 30.0)
    np.testing.assert_array_equal(truth.winding_c, 30.0)
    for _ in range(400):
        plant.step(command(HOME))
    idle = plant.truth(0.0).housing_c[0, 0]  # no load on the vertical axis
    expected = 18.0 + 12.0 * np.exp(-400 * DT / (1.5 * 1200.0))
    assert idle == pytest.approx(expected, abs=0.01)


def test_the_winding_keeps_its_temperature_when_its_housing_warms():
    """Energy: what leaves the winding enters the housing; the change of ambient itself heats nothing."""
    plant = Plant(SPEC, exact())
    plant._rise[:] = 40.0
    before = plant.truth(0.0).winding_c.copy()
    plant.step(command(HOME))
    after = plant.truth(0.0).winding_c
    lost = 40.0 / np.array([1.0] * 3 + [2.0] * 3) * DT
    capacity = np.array([40.0] * 3 + [12.0] * 3)
    np.testing.assert_allclose((before - after)[0, [0, 4, 5]], (lost / capacity)[[0, 4, 5]], rtol=0.2)
