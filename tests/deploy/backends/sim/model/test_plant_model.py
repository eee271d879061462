import re
from copy import copy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deploy.backends.sim.model.motor_parameters import RESISTANCE, RESISTANCE_PER_K
from deploy.backends.sim.model.plant_model import build
from deploy.backends.sim.plant import Plant
from deploy.backends.sim.robot import SimRobot
from robots import sensors
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.errors import ConfigError, RobotError
from robots.models.mujoco_model import load_mujoco
from robots.motors.windings import nominal_windings
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import ARM, NO_TOOL, SPEC, copy_of_arm
from support.deploy.plants import BUSY, HOME, PLAIN, PLANT_MODEL, N, command, drawn, exact

mujoco = pytest.importorskip("mujoco")
DISTRIBUTIONS = load_distributions(SPEC)
LIVED = [name for name, _, _ in DISTRIBUTIONS.spans() if not name.startswith("sensors.")]


def forward(plant, robot=0, **state):
    """The robot's own model, and its data at rest at home but for what is given."""
    model, data = plant.batch.get_model(robot), plant.batch.get_data(robot)
    for name, value in state.items():
        getattr(data, name)[:] = value
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.slow
def test_every_drawn_quantity_changes_the_plant():
    """One robot many times, each time with one quantity a little changed: no change goes unnoticed."""
    robots, seed = 1 + len(LIVED), robot_seed(1, 0)
    base = draw(DISTRIBUTIONS, SPEC, [seed]).replaced(BUSY | {"cable.length_m": 0.1})
    values = {name: np.repeat(numbers, robots, axis=0) for name, numbers in base.items()}
    for robot, name in enumerate(LIVED, 1):
        values[name][robot] += (
            0.05 * (1.0 + np.abs(values[name][robot])) * (-1.0 if "length" in name else 1.0)
        )
    plant = Plant(SPEC, DISTRIBUTIONS, Draw(values), [seed] * robots)
    folded = np.tile(HOME, (robots, 1))
    folded[:, 2], folded[:, 3] = 3.0, 1.0
    plant.reset(np.ones(robots, dtype=bool), folded)
    assert plant.truth(0.0).self_collision.all()
    for k in range(600):
        plant.step(command(folded + 0.1 * np.sin(0.05 * k)))
    seen = np.concatenate((plant.rows, plant.readings["encoder"], plant.housing), axis=1)
    same = [name for robot, name in enumerate(LIVED, 1) if (seen[robot] == seen[0]).all()]
    assert not same


def test_plant_without_a_draw_equals_model_xml():
    """Play and payload add nothing to its masses, and its gravity, friction and lengths are those of the file."""
    nominal, plant = load_mujoco(SPEC), exact()
    plant.step(command(HOME))  # brakes open
    own = plant.batch.get_model(0)
    assert own.body_mass.sum() == pytest.approx(nominal.body_mass.sum(), rel=1e-12)
    np.testing.assert_array_equal(own.opt.gravity, nominal.opt.gravity)
    for name in ("body_pos", "body_ipos", "body_inertia"):
        np.testing.assert_array_equal(getattr(own, name)[: nominal.nbody], getattr(nominal, name))
    of_windings = [
        RESISTANCE,
        RESISTANCE_PER_K,
    ]  # the drives' loops know the first at its present temperature
    np.testing.assert_allclose(own.actuator_gainprm[:, 0], nominal.actuator_gainprm[:, 0], rtol=1e-3)
    own.actuator_gainprm[:, of_windings] = nominal.actuator_gainprm[:, of_windings]
    np.testing.assert_array_equal(own.actuator_gainprm, nominal.actuator_gainprm)
    np.testing.assert_array_equal(own.dof_armature[PLANT_MODEL.dofs], nominal.dof_armature)
    data, plain = mujoco.MjData(own), mujoco.MjData(nominal)
    data.qpos[own.jnt_qposadr[PLANT_MODEL.joints]] = plain.qpos[:] = HOME
    mujoco.mj_forward(own, data)
    mujoco.mj_forward(nominal, plain)
    np.testing.assert_allclose(data.qfrc_bias[PLANT_MODEL.dofs], plain.qfrc_bias, rtol=1e-12, atol=1e-12)
    assert not data.qfrc_passive.any()


def test_mass_and_inertia_scale_together_and_everything_derived_follows():
    plant, links, model = drawn(3), slice(2, 8), PLANT_MODEL.model
    for i in range(3):
        own = plant.batch.get_model(i)
        ratio = own.body_mass[links] / model.body_mass[links]
        assert not np.isclose(ratio, 1.0, atol=1e-3).any()
        np.testing.assert_allclose(
            own.body_inertia[links] / model.body_inertia[links], ratio[:, None] * np.ones(3)
        )
        fresh = copy(model)
        for name in ("mass", "inertia", "pos", "ipos"):
            getattr(fresh, f"body_{name}")[:] = getattr(own, f"body_{name}")
        for name in ("geom_size", "geom_pos", "dof_armature", "tendon_stiffness", "site_pos"):
            getattr(fresh, name)[:] = getattr(own, name)
        mujoco.mj_setConst(fresh, mujoco.MjData(fresh))
        for name in ("body_invweight0", "dof_M0", "body_subtreemass", "geom_rbound", "dof_invweight0"):
            np.testing.assert_allclose(getattr(own, name), getattr(fresh, name), rtol=1e-12)
        assert not np.allclose(own.body_invweight0[links], model.body_invweight0[links], rtol=1e-3)


def test_no_plant_equals_the_model_that_deploy_computes_with():
    model, plant, dofs, windings = load_mujoco(SPEC), drawn(8), PLANT_MODEL.dofs, nominal_windings(SPEC)
    for i in range(8):
        own = plant.batch.get_model(i)
        for name in ("body_mass", "body_inertia", "body_ipos"):
            assert (getattr(own, name)[2:8] != getattr(model, name)[2:]).all()
        for name in ("dof_frictionloss", "dof_damping", "dof_armature"):
            assert (getattr(own, name)[dofs] != getattr(model, name)).all()
        places = [0, 1, 4, 6, 7]
        assert (own.actuator_gainprm[:, places] != model.actuator_gainprm[:, places]).all()
        assert (own.opt.gravity != model.opt.gravity).all()
        assert (plant.windings.to_housing[i] != windings.to_housing).all()
        assert (plant.windings.capacity[i] != windings.capacity).all()
        assert (plant.housings.to_ambient[i] != SPEC.motor_array("housing_resistance_k_per_w")).all()
        assert (plant.housings.capacity[i] != SPEC.motor_array("housing_capacity_j_per_k")).all()
        assert plant.truth(0.0).winding_c[i].min() > 15.0


def test_longer_links_stretch_the_arm_about_its_first_joint():
    """All by one factor: everything on it is that much farther from there; what does not move stays."""
    short, long = (forward(exact(1, {"links.length": factor})) for factor in (1.0, 1.1))
    for name in ("xpos", "xipos"):
        one, other = (getattr(data, name)[2:8] - data.xpos[2] for _, data in (short, long))
        np.testing.assert_allclose(other, 1.1 * one, atol=1e-12)
    origin = short[1].xpos[2]
    for name, which in (("geom_xpos", slice(2, None)), ("site_xpos", PLANT_MODEL.tool)):
        one, other = (getattr(data, name)[which] - origin for _, data in (short, long))
        np.testing.assert_allclose(other, 1.1 * one, atol=1e-12)
    np.testing.assert_allclose(long[0].geom_size[2:, 1], 1.1 * short[0].geom_size[2:, 1])
    np.testing.assert_array_equal(long[0].geom_size[:, 0], short[0].geom_size[:, 0])
    np.testing.assert_array_equal(long[1].xpos[:3], short[1].xpos[:3])


def test_a_longer_link_moves_only_what_comes_after_it():
    factors = np.ones(N)
    factors[1] = 1.02
    (_, one), (_, other) = forward(exact()), forward(exact(1, {"links.length": factors}))
    moved = np.linalg.norm(other.xpos - one.xpos, axis=1)
    assert moved[4:8] == pytest.approx(0.02 * 0.425, rel=1e-9)  # the upper arm is 0.425 m long
    assert not moved[:4].any()


def test_centre_of_mass_follows_the_draw():
    offset = np.random.default_rng(0).uniform(-0.05, 0.05, (N, 3))
    plant = exact(1, {"links.com_m": offset})
    np.testing.assert_allclose(
        plant.batch.get_model(0).body_ipos[2:8] - load_mujoco(SPEC).body_ipos[2:], offset
    )


@pytest.mark.parametrize("tilt", [(0.3, 0.0), (0.0, 0.3), (0.2, -0.1)])
def test_gravity_follows_the_tilt_of_the_mounting(tilt):
    own = exact(1, {"mounting.tilt_rad": np.array(tilt)}).batch.get_model(0)
    base = Rotation.from_euler("XY", tilt)
    np.testing.assert_allclose(own.opt.gravity, base.inv().apply([0.0, 0.0, -9.81]), atol=1e-12)


def test_a_cable_pulls_and_never_pushes():
    """Hooke's law between its anchor and the forearm's centre of mass, and nothing while it hangs loose."""
    anchor = np.array([0.3, -0.5, 0.4])
    changes = {"cable.stiffness_n_per_m": 30.0, "cable.anchor_m": anchor}
    model, data = forward(exact(1, changes | {"cable.length_m": 0.5}))
    forearm = model.body("forearm_link").id
    way = np.array([0.0, 0.0, DISTRIBUTIONS.cable.above_m]) + anchor - data.xipos[forearm]
    force = 30.0 * (np.linalg.norm(way) - 0.5) * way / np.linalg.norm(way)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, data.xipos[forearm], forearm)
    assert np.linalg.norm(force) > 10.0
    np.testing.assert_allclose(data.qfrc_passive, jacobian.T @ force, atol=1e-9)
    _, loose = forward(exact(1, changes | {"cable.length_m": 3.0}))
    assert not loose.qfrc_passive.any()


@pytest.mark.parametrize("load", [-0.5, 0.5])
def test_backlash_rests_on_the_side_of_the_load(load):
    """Half of the play each way; the motor and its encoder stand where they were told to."""
    play = 0.004
    plant = exact(1, {"joints.backlash_rad": play})
    plant.batch.bind("qfrc_applied")[0, PLANT_MODEL.dofs[5] + 1] = load
    for _ in range(100):
        plant.step(command(HOME))
    motor = plant.readings["encoder"][0, 5]
    assert plant.q[0, 5] - motor == pytest.approx(np.sign(load) * play / 2, abs=4e-4)
    assert plant.truth(0.0).q[0, 5] == plant.q[0, 5]


def test_motor_encoder_does_not_see_backlash():
    """A link pushed to and fro inside its play: the encoder stands still."""
    plant, ways = exact(1, {"joints.backlash_rad": 0.004}), []
    for k in range(200):
        plant.batch.bind("qfrc_applied")[0, PLANT_MODEL.dofs[5] + 1] = 0.3 * (-1) ** (k // 50)
        plant.step(command(HOME))
        ways.append((plant.q[0, 5], plant.readings["encoder"][0, 5]))
    link, motor = np.ptp(np.array(ways)[50:], axis=0)
    assert link > 0.0035
    assert motor < 0.0005


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, -0.1)])
def test_sensors_of_every_kind_read_their_sites(tmp_path, tilt):
    """At rest: gravity up, no turning, the weight behind the site, the tool's attitude; nobody touches."""
    kinds = {
        "velocity": "rad/s",
        "gyro": "rad/s",
        "accelerometer": "m/s^2",
        "orientation": "quat_wxyz",
        "torque": "N*m",
        "contact": "N",
    }
    text = "\n\n".join(
        f'[sensors.{kind}]\nunit = "{unit}"\n'
        + ("" if kind == "velocity" else 'sites = ["tool"]\n')
        + "rate_hz = 200\nresolution = 0.001\nrange = 100.0\nnoise = 0.0\nbias = 0.0\ndrift = 0.0\ndrift_per_k = 0.0\n"
        + 'delay_s = 0.005\nloss = 0.0\nsource = "test"'
        for kind, unit in kinds.items()
    )
    spec = load_robot(copy_of_arm(tmp_path, toml=[(r"\[sensors.goal\]", text + "\n\n[sensors.goal]")]))
    plant = exact(1, {"mounting.tilt_rad": np.array(tilt)}, spec=spec)
    for _ in range(400):
        plant.step(command(HOME))
    model, data = plant.batch.get_model(0), plant.batch.get_data(0)
    mujoco.mj_kinematics(model, data)
    attitude = Rotation.from_euler("XY", tilt) * Rotation.from_matrix(data.site("tool").xmat.reshape(3, 3))
    up = attitude.inv().apply([0.0, 0.0, 9.81])
    np.testing.assert_allclose(plant.readings["accelerometer"][0], up, atol=0.02)
    np.testing.assert_allclose(plant.readings["gyro"][0], 0.0, atol=1e-3)
    np.testing.assert_allclose(plant.readings["force"][0], model.body("wrist_3_link").mass * up, atol=0.02)
    said = Rotation.from_quat(plant.readings["orientation"][0], scalar_first=True)
    np.testing.assert_allclose(said.inv().apply([0.0, 0.0, 9.81]), up, atol=1e-6)
    assert (said * attitude.inv()).magnitude() < 0.02  # what is left is yaw, which gravity does not know
    assert plant.readings["torque"].shape == (1, 3)
    assert not plant.readings["contact"].any()
    np.testing.assert_array_equal(plant.readings["velocity"], plant.kinematics.motor_qd)
    for kind, channels in spec.channels.items():
        if kind != "goal":
            assert plant.readings[kind].shape == (1, channels)


def test_another_type_of_sensor_is_one_row(tmp_path, monkeypatch):
    """Declared once, it is read from robot.toml, simulated, and delivered as packets."""
    monkeypatch.setitem(sensors.KINDS, "magnetometer", sensors.SensorKind("T", "site", 3, "MAGNETOMETER"))
    text = (ARM / "robot.toml").read_text()
    table = text[text.index("[sensors.force]") : text.index("[sensors.goal]")]
    table = table.replace("sensors.force", "sensors.magnetometer").replace('"N"', '"T"')
    spec = load_robot(copy_of_arm(tmp_path, toml=[(r"\[sensors.goal\]", f"{table}\n[sensors.goal]")]))
    robot = SimRobot(spec, [robot_seed(3, 0)])
    assert robot.read()["magnetometer"].value.shape == (1, 3)
    assert np.isfinite(robot.read()["magnetometer"].value).all()


def test_an_unknown_cable_link_is_one_clear_error(tmp_path):
    folder = copy_of_arm(tmp_path)
    path = folder / "draws.toml"
    path.write_text(path.read_text().replace('link = "forearm_link"', 'link = "forearm"'))
    spec = load_robot(folder)
    with pytest.raises(ConfigError, match=re.escape(f"{path}: cable.link: found 'forearm'")) as caught:
        build(spec, load_distributions(spec).cable)
    assert "wrist_1_link" in str(caught.value)


def test_an_unknown_site_is_one_clear_error(tmp_path):
    folder = copy_of_arm(tmp_path, toml=[(r'sites = \["tool"\]', 'sites = ["flange"]')])
    spec = load_robot(folder)
    where = re.escape(f"{spec.folder / 'robot.toml'}: sensors.force.sites: found 'flange'")
    with pytest.raises(RobotError, match=where) as caught:
        build(spec, load_distributions(spec).cable)
    assert "tool" in str(caught.value)


def test_vendor_settings_in_model_xml_do_not_break_the_plant(tmp_path):
    """A keyframe of the nominal size, degrees, joints with defaults of their own, bodies fused."""
    folder = copy_of_arm(
        tmp_path,
        xml=[
            ("</mujoco>", '<keyframe><key qpos="0 -1.57 1.57 -1.57 -1.57 0"/></keyframe></mujoco>'),
            (r"<compiler ", '<compiler fusestatic="true" '),
            (r'<joint axis="0 0 1" ', '<joint axis="0 0 1" frictionloss="5" stiffness="7" ref="0.1" '),
        ],
    )
    plant_model = build(load_robot(folder), DISTRIBUTIONS.cable)
    play, model = plant_model.backlash, plant_model.model
    dofs = model.jnt_dofadr[play]
    assert not model.dof_frictionloss[dofs].any()
    assert not model.jnt_stiffness[play].any()
    assert not model.qpos0[model.jnt_qposadr[play]].any()
    assert (model.dof_frictionloss[plant_model.dofs] > 0).all()
    assert model.jnt_limited[play].all()
    assert PLAIN["joints.backlash_rad"] == 0.0


def test_an_arm_without_a_tool_carries_its_payload_on_its_last_link(tmp_path):
    """It comes to rest where it is sent, with a payload and without."""
    spec = load_robot(copy_of_arm(tmp_path, toml=NO_TOOL))
    plant_model = build(spec, DISTRIBUTIONS.cable)
    model = plant_model.model
    assert model.body_parentid[plant_model.payload] == plant_model.bodies[-1]
    assert model.site_bodyid[plant_model.tool] == plant_model.bodies[-1]
    load = {"payload.mass_kg": 3.0, "payload.free_s": 1e-3, "payload.carried_s": 1e6}
    plant = exact(1, load, spec=spec)
    for _ in range(400):
        plant.step(command(HOME))
    assert plant.valid.all()
    assert plant.disturbances["payload"].on.all()
    np.testing.assert_allclose(plant.q[0], HOME, atol=0.05)


def test_a_joint_may_be_called_like_the_backlash_of_another(tmp_path):
    folder = copy_of_arm(tmp_path)
    for file in ("model.xml", "robot.toml"):
        text = (folder / file).read_text()
        (folder / file).write_text(text.replace('"elbow"', '"shoulder_pan/backlash"'))
    spec = load_robot(folder)
    assert len(set(build(spec, DISTRIBUTIONS.cable).backlash)) == N
