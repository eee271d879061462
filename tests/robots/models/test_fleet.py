import re

import numpy as np
import pinocchio as pin
import pytest

from robots.errors import RobotError
from robots.models.blocks import BLOCK
from robots.models.collisions import collision_pairs
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.models.tool_jacobian import find_manipulability
from robots.robot_file import JOINTS_MAX
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm
from support.robots.model_files import POST

mujoco = pytest.importorskip("mujoco")
load_mujoco = pytest.importorskip("robots.models.mujoco_model").load_mujoco

from robots.models.mujoco_model import PHYSICS, UNSUITABLE

STATES = 2000
N = SPEC.n
LOW, HIGH = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")


@pytest.fixture(scope="module")
def both():
    model = load_mujoco(SPEC)
    arm, shapes = load_pinocchio(SPEC)
    return model, mujoco.MjData(model), arm, arm.createData(), shapes


def with_pairs(arm):
    _, shapes = load_pinocchio(SPEC)
    for pair in collision_pairs(arm, shapes):
        shapes.addCollisionPair(pin.CollisionPair(*pair))
    return shapes


def random_states(seed, count=STATES):
    """Angles over the whole turn, far beyond the working range, and speeds."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-np.pi, np.pi, (count, N)), rng.uniform(-4, 4, (count, N))


def test_joint_order_is_the_same(both):
    model, _, arm, _, _ = both
    names = tuple(model.joint(i).name for i in range(model.njnt))
    assert names == tuple(arm.names[1:]) == SPEC.joint_names
    assert [model.joint(name).qposadr[0] for name in names] == list(range(N))
    assert [arm.joints[arm.getJointId(name)].idx_q for name in names] == list(range(N))


def test_kinematics_of_the_tool_agree(both):
    model, data, arm, arm_data, _ = both
    site, frame = model.site(SPEC.tool).id, arm.getFrameId(SPEC.tool)
    jacobian, worst = np.zeros((6, N)), 0.0
    for q in random_states(0)[0]:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        expected = pin.computeFrameJacobian(arm, arm_data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(arm, arm_data, q)
        placement = arm_data.oMf[frame]
        worst = max(
            worst,
            np.abs(data.site_xpos[site] - placement.translation).max(),
            np.abs(data.site_xmat[site].reshape(3, 3) - placement.rotation).max(),
            np.abs(jacobian - expected).max(),
        )
    assert worst <= 1e-10


def test_dynamics_agree(both):
    model, data, arm, arm_data, _ = both
    dense, worst = np.zeros((N, N)), 0.0
    for q, qd in zip(*random_states(1), strict=True):
        data.qpos[:], data.qvel[:] = q, qd
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        upper = np.triu(pin.crba(arm, arm_data, q))
        mass = upper + np.triu(upper, 1).T
        bias = pin.nonLinearEffects(arm, arm_data, q, qd)
        worst = max(worst, np.abs(dense - mass).max(), np.abs(data.qfrc_bias - bias).max())
    assert worst <= 1e-10


def test_inverse_dynamics_holds_the_simulated_arm(both):
    """The torque that `Fleet` computes for an acceleration gives this acceleration in MuJoCo, losses apart."""
    model, data, _, _, _ = both
    fleet = Fleet(SPEC, 1)
    q, qd = random_states(2, 50)
    qdd = np.random.default_rng(3).uniform(-10, 10, (50, N))
    for i in range(50):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], qd[i], qdd[i]
        dense = np.zeros((N, N))
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        expected = dense @ qdd[i] + data.qfrc_bias
        np.testing.assert_allclose(
            fleet.torque(q[i : i + 1], qd[i : i + 1], qdd[i : i + 1])[0], expected, atol=1e-10
        )


def test_forward_dynamics_agree_with_friction(both):
    """MuJoCo's acceleration under a torque, with the losses of every joint taken away by hand: all slide."""
    model, data, _, _, _ = both
    q, qd = random_states(4, 60)
    qd += np.sign(qd) * 0.5
    tau = np.random.default_rng(5).uniform(-20, 20, (60, N))
    found = Fleet(SPEC, 60).acceleration(q, qd, tau)
    dense = np.zeros((N, N))
    for i in range(60):
        data.qpos[:], data.qvel[:] = q[i], qd[i]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        losses = model.dof_damping * qd[i] + model.dof_frictionloss * np.sign(qd[i])
        expected = np.linalg.solve(dense, tau[i] - losses - data.qfrc_bias)
        np.testing.assert_allclose(found[i], expected, rtol=1e-6, atol=1e-6)


def test_torque_limits_are_those_of_the_joints(both):
    model, _, arm, _, _ = both
    np.testing.assert_array_equal(torque_max(SPEC), model.jnt_actfrcrange[:, 1])
    np.testing.assert_array_equal(torque_max(SPEC), -model.jnt_actfrcrange[:, 0])
    np.testing.assert_array_equal(arm.armature, model.dof_armature)


def test_collisions_agree(both):
    """Every pair that is not within 0.1 mm of just touching gets one verdict from both libraries.

    Left out: links that have gone far through the table, which MuJoCo (capsule against box) no longer sees; no robot
    gets there without having touched it.
    """
    model, data, arm, arm_data, _ = both
    shapes = with_pairs(arm)
    shapes_data, verdicts = shapes.createData(), []
    names = [
        [shapes.geometryObjects[i].name for i in (pair.first, pair.second)] for pair in shapes.collisionPairs
    ]
    for q in random_states(4)[0]:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        touching = {frozenset(model.geom(geom).name for geom in contact.geom) for contact in data.contact}
        assert touching <= {frozenset(pair) for pair in names}
        pin.computeDistances(arm, arm_data, shapes, shapes_data, q)
        for pair, result in zip(names, shapes_data.distanceResults, strict=True):
            through = "table" in pair and result.min_distance < -0.15
            if abs(result.min_distance) > 1e-4 and not through:
                verdicts.append((frozenset(pair) in touching, result.min_distance < 0))
    verdicts = np.array(verdicts)
    assert len(verdicts) > 0.95 * STATES * len(names)
    assert verdicts[:, 0].sum() > STATES
    np.testing.assert_array_equal(verdicts[:, 0], verdicts[:, 1])


def test_fleet_keeps_the_collision_margin(both):
    _, _, arm, arm_data, _ = both
    shapes = with_pairs(arm)
    shapes_data, q = shapes.createData(), np.random.default_rng(5).uniform(LOW, HIGH, (512, N))
    fleet, margin, found, counted = Fleet(SPEC, 32, collisions=True), SPEC.margins.collision_m, [], 0
    for block in np.split(q, 16):
        kinematics = fleet.kinematics(block)
        found.extend(kinematics.colliding)
    for i in range(512):
        pin.computeDistances(arm, arm_data, shapes, shapes_data, q[i])
        nearest = min(result.min_distance for result in shapes_data.distanceResults)
        if abs(nearest - margin) > 1e-4:
            assert found[i] == (nearest < margin), (q[i], nearest)
            counted += 1
    assert counted > 500
    assert 50 < sum(found) < 450


def test_all_pairs_but_neighbours_are_checked(both):
    _, _, arm, _, shapes = both
    pairs = {frozenset(shapes.geometryObjects[i].name for i in pair) for pair in collision_pairs(arm, shapes)}
    chain = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    expected = {frozenset((a, b)) for i, a in enumerate(chain) for b in chain[i + 2 :]}
    expected |= {frozenset((fixed, link)) for fixed in ("table", "base") for link in chain[1:]}
    assert pairs == expected


def test_fleet_without_collision_checks_refuses_queries():
    fleet = Fleet(SPEC, 1)
    kinematics = fleet.kinematics(SPEC.joint_array("q_home")[None])
    with pytest.raises(RuntimeError, match="without collisions"):
        _ = kinematics.colliding


def test_one_pose_gives_tool_and_collisions():
    fleet, other = Fleet(SPEC, 40, collisions=True), Fleet(SPEC, 40, collisions=True)
    q = np.random.default_rng(0).uniform(LOW, HIGH, (40, N))
    other_kinematics = other.kinematics(q)
    kinematics = fleet.kinematics(np.tile(SPEC.joint_array("q_home"), (40, 1)))
    kinematics = fleet.kinematics(q, jacobians=False)
    np.testing.assert_array_equal(kinematics.tool_position, other_kinematics.tool_position)
    np.testing.assert_array_equal(kinematics.colliding, other_kinematics.colliding)
    assert 0 < kinematics.colliding.sum() < 40


@pytest.mark.parametrize("robots", [1, 16, 17, 64])
def test_fleet_equals_single_robots(robots):
    arm, _ = load_pinocchio(SPEC)
    data, frame, fleet = arm.createData(), arm.getFrameId(SPEC.tool), Fleet(SPEC, robots)
    rng = np.random.default_rng(robots)
    for _ in range(5):
        q, qd, qdd = (
            rng.uniform(-3, 3, (robots, N)),
            rng.normal(0, 2, (robots, N)),
            rng.normal(0, 9, (robots, N)),
        )
        tau = fleet.torque(q, qd, qdd)
        kinematics = fleet.kinematics(q)
        velocity, manipulability = kinematics.tool_velocity(qd), kinematics.manipulability()
        for i in range(robots):
            np.testing.assert_allclose(tau[i], pin.rnea(arm, data, q[i], qd[i], qdd[i]), rtol=0, atol=1e-11)
            jacobian = pin.computeFrameJacobian(arm, data, q[i], frame, pin.LOCAL_WORLD_ALIGNED)
            pin.framesForwardKinematics(arm, data, q[i])
            np.testing.assert_allclose(
                kinematics.tool_position[i], data.oMf[frame].translation, rtol=0, atol=1e-12
            )
            np.testing.assert_allclose(velocity[i], jacobian[:3] @ qd[i], rtol=0, atol=1e-12)
            expected = np.sqrt(max(0.0, np.linalg.det(jacobian @ jacobian.T)))
            np.testing.assert_allclose(np.abs(manipulability[i]), expected, rtol=0, atol=1e-9)


def test_robots_are_independent_to_the_bit():
    """Nor do those that took the same model before."""
    robots = 2 * BLOCK + 4
    rng, fleet, alone = (
        np.random.default_rng(0),
        Fleet(SPEC, robots, collisions=True),
        Fleet(SPEC, 1, collisions=True),
    )
    q, qd = rng.uniform(LOW, HIGH, (robots, N)), rng.normal(0, 1, (robots, N))
    tau = fleet.torque(q, qd, qd)
    kinematics = fleet.kinematics(q)
    for i in range(robots):
        one = slice(i, i + 1)
        np.testing.assert_array_equal(alone.torque(q[one], qd[one], qd[one])[0], tau[i])
        alone_kinematics = alone.kinematics(q[one])
        np.testing.assert_array_equal(alone_kinematics.tool_position[0], kinematics.tool_position[i])
        np.testing.assert_array_equal(
            alone_kinematics.tool_velocity(qd[one])[0], kinematics.tool_velocity(qd)[i]
        )
        assert alone_kinematics.colliding[0] == kinematics.colliding[i]
    assert 0 < kinematics.colliding.sum() < robots


def test_robot_with_nan_affects_no_other_robot():
    q = np.tile(SPEC.joint_array("q_home"), (18, 1))
    fleet = Fleet(SPEC, 18, collisions=True)
    kinematics = fleet.kinematics(q)
    clean = kinematics.tool_position.copy(), fleet.torque(q, q, q), kinematics.colliding.copy()
    q[[0, 5, 17]] = np.nan
    kinematics = fleet.kinematics(q)
    others = np.isfinite(q).all(axis=1)
    np.testing.assert_array_equal(kinematics.tool_position[others], clean[0][others])
    np.testing.assert_array_equal(fleet.torque(q, q, q)[others], clean[1][others])
    np.testing.assert_array_equal(kinematics.colliding[others], clean[2][others])
    assert np.isnan(kinematics.tool_position[~others]).all()


def test_tool_velocity_is_the_derivative_of_tool_position():
    rng, fleet, h = np.random.default_rng(1), Fleet(SPEC, 50), 1e-6
    q, qd = rng.uniform(LOW, HIGH, (50, N)), rng.normal(0, 2, (50, N))
    kinematics = fleet.kinematics(q + h * qd)
    ahead = kinematics.tool_position.copy()
    kinematics = fleet.kinematics(q - h * qd)
    difference = (ahead - kinematics.tool_position) / (2 * h)
    kinematics = fleet.kinematics(q)
    np.testing.assert_allclose(kinematics.tool_velocity(qd), difference, rtol=0, atol=1e-7)


def test_manipulability_vanishes_where_the_arm_is_singular():
    """Straight wrist, straight elbow: a direction is lost. At home: none."""
    home = SPEC.joint_array("q_home")
    wrist, elbow = home.copy(), home.copy()
    wrist[4], elbow[2] = 0.0, 0.0
    fleet = Fleet(SPEC, 3)
    kinematics = fleet.kinematics(np.stack((wrist, elbow, home)))
    lost_wrist, lost_elbow, free = kinematics.manipulability()
    assert abs(lost_wrist) < 1e-12
    assert abs(lost_elbow) < 1e-12
    assert free > 10 * SPEC.margins.singularity


def test_manipulability_is_negative_beyond_a_singularity():
    """A step from one side to the other, however far from zero it lands, is seen."""
    home, fleet = SPEC.joint_array("q_home"), Fleet(SPEC, 2)
    beyond = home.copy()
    beyond[4] *= -1  # wrist 2, singular at 0
    kinematics = fleet.kinematics(np.stack((home, beyond)))
    here, there = kinematics.manipulability()
    assert here > 10 * SPEC.margins.singularity
    assert there < -10 * SPEC.margins.singularity


def test_home_pose_determines_the_side_of_a_singularity(tmp_path):
    """An arm that lives with its wrist turned is free there, and beyond a singularity where arm6 lives."""
    ends = ("q_min = -2.6\nq_max = -0.5\nq_home = -1.5708", "q_min = 0.5\nq_max = 2.6\nq_home = 1.5708")
    turned = load_robot(copy_of_arm(tmp_path, toml=[ends]))
    fleet = Fleet(turned, 2)
    kinematics = fleet.kinematics(np.stack((turned.joint_array("q_home"), SPEC.joint_array("q_home"))))
    here, there = kinematics.manipulability()
    assert here > 10 * SPEC.margins.singularity
    assert there < -10 * SPEC.margins.singularity


def test_a_home_pose_in_a_singularity_is_refused(tmp_path):
    ends = ("q_min = -2.6\nq_max = -0.5\nq_home = -1.5708", "q_min = -2.6\nq_max = 0.5\nq_home = 0.0")
    with pytest.raises(RobotError, match=r"q_home.*expected at least margins\.singularity, 0\.0005"):
        Fleet(load_robot(copy_of_arm(tmp_path, toml=[ends])), 1)


@pytest.mark.parametrize("n", [2, 5, 7])
def test_manipulability_of_other_numbers_of_joints(n):
    """The product of the singular values, however many columns there are."""
    jacobians = np.random.default_rng(n).normal(size=(4, 6, n))
    expected = [np.prod(np.linalg.svd(jacobian, compute_uv=False)) for jacobian in jacobians]
    found = np.empty(4)
    find_manipulability(jacobians, np.zeros((4, 3)), np.arange(n), found)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


WRIST_3 = r'(?s)<joint name="wrist_3" class="size1"/>'


@pytest.mark.parametrize(
    ("load", "toml", "xml", "words"),
    [
        ("both", [], [("</mujoco>", "")], ["read"]),
        ("both", [], [("<mujoco model", "<mujoco modle")], ["cannot read it"]),
        ("both", [('tool = "tool"', 'tool = "hand"')], [], ["no site or body named 'hand'"]),
        ("both", [], [('<site name="tool"', '<site name="tip"')], ["no site or body named 'tool'"]),
        ("both", [], [(WRIST_3, '<joint name="wrist_4" class="size1"/>'), ('joint="wrist_3"', 'joint="wrist_4"')],
         ["wrist_4", "robot.toml lists"]),
        ("pinocchio", [], [("</worldbody>", POST + "</body></worldbody>")], ["2 bodies", "expected 1"]),
        ("pinocchio", [], [(WRIST_3, '<joint name="wrist_3" class="size1" type="slide"/>')],
         ["'wrist_3' is JointModelPZ", "expected a hinge"]),
        ("mujoco", [], [(r'<dcmotor name="wrist_3" joint="wrist_3" class="size1"/>', "")], ["drives", "wrist_3"]),
        ("mujoco", [], [('(?s)(<dcmotor name="wrist_2".*?/>)(.*?)(<dcmotor name="wrist_3".*?/>)', r"\3\2\1")],
         ["drives move", "wrist_3', 'wrist_2"]),
        ("mujoco", [], [('thermal="2.0 12 0 0.0039 25 25"', "")], ["states", "thermal"]),
        ("mujoco", [], [('input="pos vel ff"', 'input="pos vel"')], ["controls", "pos vel ff"]),
        ("torque", [], [('actuatorfrcrange="-28 28" ', "")], ["no actuatorfrcrange", "wrist_1, wrist_2, wrist_3"]),
    ],
)  # fmt: skip
def test_a_wrong_model_is_one_clear_error(tmp_path, load, toml, xml, words):
    spec = load_robot(copy_of_arm(tmp_path, toml=toml, xml=xml))
    loaders = {
        "both": (load_mujoco, load_pinocchio),
        "pinocchio": (load_pinocchio,),
        "mujoco": (load_mujoco,),
        "torque": (torque_max,),
    }
    for loader in loaders[load]:
        with pytest.raises(RobotError, match=re.escape(str(spec.model_path))) as caught:
            loader(spec)
        for word in words:
            assert word in str(caught.value)


def test_too_many_joints_of_a_model_are_refused_before_they_take_memory(tmp_path):
    """Locked ones count, for Pinocchio removes them from a model that has them."""
    names = [f"finger_{number}" for number in range(JOINTS_MAX - N + 1)]
    hand = "".join(f'<body><joint name="{name}"/><geom size="0.01"/></body>' for name in names)
    folder = copy_of_arm(
        tmp_path, toml=[("\ntool", f"\nlocked = {names}\ntool")], xml=[('<site name="tool"', hand + r"\g<0>")]
    )
    with pytest.raises(RobotError, match=r"model\.xml: found 129 joints, expected at most 128"):
        load_pinocchio(load_robot(folder))


@pytest.mark.parametrize(
    ("flag", "found", "expected"),
    [
        *((flag, "disable", "enable") for flag in PHYSICS),
        *((flag, "enable", "disable") for flag in UNSUITABLE),
    ],
)
def test_a_flag_that_changes_the_physics_is_refused(tmp_path, flag, found, expected):
    def robot(value):
        option = f'<option><flag {flag}="{value}"/></option>'
        return load_robot(copy_of_arm(tmp_path / value, xml=[("</mujoco>", rf"{option}\g<0>")]))

    with pytest.raises(RobotError) as caught:
        load_mujoco(robot(found))
    assert f"model.xml: option flag {flag}: found '{found}', expected '{expected}'" in str(caught.value)
    assert load_mujoco(robot(expected)).njnt == N


@pytest.mark.parametrize("option", ['density="50"', 'viscosity="1"', 'wind="0 1 0"'])
def test_a_medium_that_brakes_the_robot_is_refused(tmp_path, option):
    robot = copy_of_arm(tmp_path, xml=[("</mujoco>", rf"<option {option}/>\g<0>")])
    with pytest.raises(
        RobotError, match=rf"model\.xml: option {option.partition('=')[0]}: found .*, expected 0$"
    ):
        load_mujoco(load_robot(robot))


@pytest.mark.parametrize("loader", [load_mujoco, load_pinocchio])
def test_joints_in_another_order_are_refused(tmp_path, loader):
    """robot.toml and model.xml must agree on the order: nothing is guessed."""
    folder = copy_of_arm(tmp_path)
    path = folder / "robot.toml"
    head, *joints = re.split(r"(?m)^(?=\[\[joints\]\])", path.read_text())
    joints[4], joints[5] = joints[5], joints[4]
    path.write_text(head + "".join(f"{joint.rstrip()}\n\n" for joint in joints))
    with pytest.raises(RobotError, match=re.escape(str(folder / "model.xml")) + ".*wrist_3', 'wrist_2"):
        loader(load_robot(folder))


@pytest.mark.parametrize("loader", [load_mujoco, load_pinocchio])
def test_a_missing_model_is_one_clear_error(tmp_path, loader):
    folder = copy_of_arm(tmp_path)
    (folder / "model.xml").unlink()
    with pytest.raises(RobotError, match=re.escape(str(folder / "model.xml"))):
        loader(load_robot(folder))


def test_physics_runs_at_the_rate_of_the_robot_file(tmp_path):
    folder = copy_of_arm(tmp_path, toml=[("physics_hz = 1000", "physics_hz = 2000")])
    assert load_mujoco(load_robot(folder)).opt.timestep == 0.0005
