"""Sources of joints, motors and tool, against closed forms and against the ground truth of exact robots."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deploy.sources.joints import ROOM_C
from deploy.sources.link_rotation import euler_yxz, link_rotations
from robots.models.mujoco_model import load_mujoco
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm
from support.contracts import arm_contract
from support.deploy.exact_robots import exact_runtime, observe
from support.walking import QUADRUPED

N = SPEC.n
TORQUE = """[sensors.torque]
unit = "N*m"
sites = ["tool"]
rate_hz = 200
resolution = 0.001
range = 10.0
noise = 0.01
bias = 0.0
drift = 0.0
drift_per_k = 0.0
delay_s = 0.0
loss = 0.0
source = "estimate"

[sensors.goal]"""
SOURCES = (
    *("joint_position", "joint_velocity", "joint_sin_cos", "joint_euler", "joint_rotation_rate"),
    *("joint_torque", "motor_current", "motor_temperature", "tool_force", "tool_torque"),
)


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    """The arm with a torque sensor at its tool, and with a force sensor of high resolution."""
    edits = [(r"\[sensors\.goal\]", TORQUE), (r"resolution = 0\.1\b", "resolution = 0.001")]
    return load_robot(copy_of_arm(tmp_path_factory.mktemp("sensed"), toml=edits))


@pytest.fixture(scope="module")
def moving(spec):
    """An exact arm 0.6 s after it began to turn its shoulder and elbow."""
    runtime = exact_runtime(spec, arm_contract, SOURCES)
    observe(runtime, 10)
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    action = np.array([[0.5, 0.3, -0.5, 0.2, 0.0, 0.0]])
    return runtime, observe(runtime, 30, action)


def relative_rotations(spec, q):
    """(n, 3, 3) rotation of each joint's body relative to that of the joint before, by MuJoCo."""
    model = load_mujoco(spec)
    data = mujoco.MjData(model)
    for name, angle in zip(spec.joint_names, q, strict=True):
        data.joint(name).qpos[0] = angle
    mujoco.mj_kinematics(model, data)
    bodies = [model.jnt_bodyid[model.joint(name).id] for name in spec.joint_names]
    moving = set(bodies)
    found = []
    for body in bodies:
        before = model.body_parentid[body]
        while before not in moving and model.body_dofnum[before] == 0 and before:
            before = model.body_parentid[before]
        found.append(data.xmat[before].reshape(3, 3).T @ data.xmat[body].reshape(3, 3))
    return np.array(found)


@pytest.mark.parametrize("robot", [SPEC, QUADRUPED], ids=lambda spec: spec.name)
def test_link_rotations_are_those_of_mujoco(robot):
    links, rng = link_rotations(robot), np.random.default_rng(0)
    for q in rng.uniform(robot.joint_array("q_min"), robot.joint_array("q_max"), (20, robot.n)):
        sin, cos = np.sin(q)[:, None, None], np.cos(q)[:, None, None]
        R = links.mean + sin * links.sine + cos * links.cosine
        np.testing.assert_allclose(R, relative_rotations(robot, q), atol=1e-9)


def test_euler_angles_are_those_of_scipy_and_rebuild_the_rotation():
    R = Rotation.random(500, rng=np.random.default_rng(1))
    x, y, z = euler_yxz(R.as_matrix(), np.zeros(500, dtype=bool)).T
    np.testing.assert_allclose(np.stack((y, x, z), axis=1), R.as_euler("YXZ"), atol=1e-9)


def test_euler_angles_where_two_axes_fall_together():
    """As Godot: z is 0, and the rotation is still the same."""
    for sign in (1.0, -1.0):
        R = Rotation.from_euler("YXZ", [[0.4, sign * np.pi / 2, 0.3]])
        angles = euler_yxz(R.as_matrix(), np.zeros(1, dtype=bool))[0]
        assert angles[2] == 0.0
        again = Rotation.from_euler("YXZ", angles[[1, 0, 2]])
        np.testing.assert_allclose(again.as_matrix(), R.as_matrix()[0], atol=1e-5)


def test_a_link_that_turns_about_x_alone_has_its_whole_angle_as_x():
    q = np.linspace(-3.1, 3.1, 21)
    angles = euler_yxz(Rotation.from_euler("x", q[:, None]).as_matrix(), np.ones(21, dtype=bool))
    np.testing.assert_allclose(angles, np.stack((q, 0 * q, 0 * q), axis=1), atol=1e-12)
    about_x = link_rotations(QUADRUPED).about_x
    assert [name for name, x in zip(QUADRUPED.joint_names, about_x, strict=True) if x] == [
        name for name in QUADRUPED.joint_names if "abduction" in name
    ]


def test_rotation_rates_are_the_derivative_of_the_rotations():
    links, q, qd, dt = link_rotations(SPEC), SPEC.joint_array("q_home"), np.linspace(-1, 1, N), 1e-6
    before, after = (relative_rotations(SPEC, angles) for angles in (q, q + dt * qd))
    turned = Rotation.from_matrix(before.swapaxes(1, 2) @ after).as_rotvec() / dt
    np.testing.assert_allclose(links.axis * qd[:, None], turned, atol=1e-5)


def test_joint_readings_follow_from_the_estimate(moving):
    runtime, seen = moving
    q, qd = seen["joint_position"], seen["joint_velocity"]
    truth = runtime.robot.truth()
    assert np.abs(truth.qd[0, :4]).min() > 0.05
    sin_cos = seen["joint_sin_cos"].reshape(N, 2)
    np.testing.assert_allclose(np.arctan2(*sin_cos.T), q[0], atol=1e-6)
    euler = seen["joint_euler"].reshape(N, 3)
    R = Rotation.from_euler("YXZ", euler[:, [1, 0, 2]]).as_matrix()
    np.testing.assert_allclose(R, relative_rotations(SPEC, q[0]), atol=1e-5)
    rate = seen["joint_rotation_rate"].reshape(N, 3)
    np.testing.assert_allclose(np.linalg.norm(rate, axis=1), np.abs(qd[0]), atol=1e-6)


def test_torque_is_current_times_constant_and_that_of_the_plant(moving):
    runtime, seen = moving
    # Gear 101, 0.1 N·m/A: see model.xml.
    np.testing.assert_allclose(seen["joint_torque"], 10.1 * seen["motor_current"], rtol=0.02)
    # The observation is up to one policy period older than the truth.
    np.testing.assert_allclose(seen["joint_torque"], runtime.robot.truth().tau, atol=2.0)
    assert np.abs(seen["joint_torque"][0, 1]) > 20.0


def test_motor_temperature_is_that_of_the_housing(moving):
    runtime, seen = moving
    np.testing.assert_allclose(seen["motor_temperature"], runtime.robot.truth().housing_c, atol=0.5)
    runtime.estimator.windings.housing[:] = np.nan
    read = observe(runtime)["motor_temperature"]
    assert ((read == ROOM_C) | (np.abs(read - runtime.robot.truth().housing_c) < 0.5)).all()


def test_tool_sensor_at_rest_reads_the_weight_of_the_last_link(spec):
    runtime = exact_runtime(spec, arm_contract, SOURCES)
    seen, model = observe(runtime, 100), load_mujoco(SPEC)
    data = mujoco.MjData(model)
    data.qpos[:] = SPEC.joint_array("q_home")
    mujoco.mj_forward(model, data)
    R, body = data.site("tool").xmat.reshape(3, 3), data.body("wrist_3_link")
    weight = model.body("wrist_3_link").mass[0] * model.opt.gravity
    lever = body.xipos - data.site("tool").xpos
    np.testing.assert_allclose(seen["tool_force"][0], -R.T @ weight, atol=0.02)
    np.testing.assert_allclose(seen["tool_torque"][0], -R.T @ np.cross(lever, weight), atol=0.005)
    assert np.linalg.norm(weight) == pytest.approx(3.58, abs=0.01)
