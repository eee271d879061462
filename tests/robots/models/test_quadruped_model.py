"""The shipped quadruped in both libraries with its floating base, how it stands in them, and its mirror images."""

import shutil

import numpy as np
import pinocchio as pin
import pytest

from robots.errors import RobotError
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio
from robots.spec import load_robot
from support.quadruped import HOME, QUADRUPED

mujoco = pytest.importorskip("mujoco")
load_mujoco = pytest.importorskip("robots.models.mujoco_model").load_mujoco
build = pytest.importorskip("deploy.backends.sim.model.plant_model").build
load_distributions = pytest.importorskip("robots.distributions").load_distributions

N, BASE = QUADRUPED.n, 6
GO1_KG = 12.743448
"""go1_description with rotors: the sum of its links."""


def test_mass_matrix_and_gravity_with_the_floating_base():
    """MuJoCo's velocities of the base are in the world (linear) and in the base (angular), Pinocchio's in the base."""
    model, free = load_mujoco(QUADRUPED), pin.buildModelFromMJCF(str(QUADRUPED.model_path))
    data, free_data = mujoco.MjData(model), free.createData()
    dense, turn = np.zeros((model.nv, model.nv)), np.eye(model.nv)
    rng = np.random.default_rng(0)
    for _ in range(300):
        quat = rng.normal(size=4)
        quat /= np.linalg.norm(quat)
        place, q = rng.normal(size=3), rng.uniform(-np.pi, np.pi, N)
        data.qpos[:] = np.concatenate((place, quat, q))
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        x = np.concatenate((place, np.roll(quat, -1), q))  # Pinocchio: w last
        upper = np.triu(pin.crba(free, free_data, x))
        turn[:3, :3] = pin.Quaternion(*quat).matrix().T  # from the world into the base
        mass = turn.T @ (upper + np.triu(upper, 1).T) @ turn
        np.testing.assert_allclose(dense, mass, rtol=0, atol=1e-10)
        gravity = turn.T @ pin.computeGeneralizedGravity(free, free_data, x)
        np.testing.assert_allclose(data.qfrc_bias, gravity, rtol=0, atol=1e-10)


def test_it_weighs_what_the_vendor_says():
    model = load_mujoco(QUADRUPED)
    assert model.body_mass.sum() == pytest.approx(GO1_KG)
    assert sum(inertia.mass for inertia in pin.buildModelFromMJCF(str(QUADRUPED.model_path)).inertias) == (
        pytest.approx(GO1_KG)
    )


def test_motors_hold_many_times_the_weight():
    """At home, by statics: each foot carries a quarter, under its hip."""
    kinematics = Fleet(QUADRUPED, 1).kinematics(HOME[None])
    lever = np.array([abs(0.213 * np.sin(HOME[1]))] * 4)  # of the knee, horizontally from its foot
    tau = GO1_KG * 9.81 / 4 * lever
    assert (tau < 0.2 * load_mujoco(QUADRUPED).jnt_actfrcrange[3::3, 1]).all()
    hips = np.array([[0.1881, -0.12675], [0.1881, 0.12675], [-0.1881, -0.12675], [-0.1881, 0.12675]])
    imu = np.array([-0.01592, -0.06659])
    np.testing.assert_allclose(kinematics.feet_position[0, :, :2], hips - imu, atol=1e-12)


def test_it_stands_on_its_feet_at_home():
    """Only the feet touch the floor, and no link another one."""
    plant = build(QUADRUPED, load_distributions(QUADRUPED).cable)
    data = mujoco.MjData(plant.model)
    for name, q in zip(QUADRUPED.joint_names, HOME, strict=True):
        data.joint(name).qpos[0] = q
    data.qpos[2] = plant.base.stands_m - 1e-4
    mujoco.mj_forward(plant.model, data)
    touching = {plant.model.geom(geom).name for contact in data.contact for geom in contact.geom}
    assert touching == {"firstshift/floor", *(f"{foot}_foot" for foot in QUADRUPED.base.feet)}
    assert plant.base.stands_m == pytest.approx(2 * 0.213 * np.cos(0.9) + 0.02, abs=1e-9)


def test_left_is_the_mirror_image_of_right():
    """Calves apart, which are the same part on both sides."""
    arm, _ = load_pinocchio(QUADRUPED)
    for number in range(1, N + 1):
        name = arm.names[number]
        if name[1] != "R" or "calf" in name:
            continue
        other = arm.getJointId(f"{name[0]}L{name[2:]}")
        mirror = np.diag([1.0, -1.0, 1.0])
        right, left = arm.inertias[number], arm.inertias[other]
        assert left.mass == right.mass
        np.testing.assert_allclose(left.lever, mirror @ right.lever, atol=1e-12)
        np.testing.assert_allclose(left.inertia, mirror @ right.inertia @ mirror, atol=1e-7)


def test_no_link_is_near_another_in_ordinary_poses():
    """Joints up to 0.4 rad from home: a walk touches nothing."""
    q = HOME + np.random.default_rng(0).uniform(-0.4, 0.4, (500, N))
    assert not Fleet(QUADRUPED, 500, collisions=True).kinematics(q).colliding.any()


def test_crossed_feet_are_a_collision():
    q = HOME.copy()
    q[[0, 3]] = 0.45, -0.45
    assert Fleet(QUADRUPED, 1, collisions=True).kinematics(q[None]).colliding.all()


@pytest.mark.parametrize("height", [0.3, 0.5])
def test_a_robot_that_would_count_as_fallen_where_it_stands_is_refused(tmp_path, height):
    folder = tmp_path / "quadruped"
    shutil.copytree(QUADRUPED.folder, folder)
    text = (folder / "robot.toml").read_text()
    assert "height_min_m = 0.16" in text
    (folder / "robot.toml").write_text(text.replace("height_min_m = 0.16", f"height_min_m = {height}"))
    with pytest.raises(RobotError, match=rf"base\.height_min_m: found {height}, expected less than 0\.259 m"):
        load_pinocchio(load_robot(folder))
