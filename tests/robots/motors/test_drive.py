import re

import numpy as np
import pytest

from robots.errors import RobotError
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.drive_gains import drive_gains
from robots.motors.windings import nominal_windings
from robots.spec import load_robot
from support.arm6 import SPEC, complaint, copy_of_arm
from support.robots.motors import DRIVES, VENDOR, declared

mujoco = pytest.importorskip("mujoco")
model_mujoco = pytest.importorskip("robots.models.mujoco_model")


def test_declared_drives_equal_those_of_the_model(tmp_path):
    """Every number that MuJoCo makes of both ways of saying it."""
    found, expected = (model_mujoco.load_mujoco(spec) for spec in (load_robot(declared(tmp_path)), SPEC))
    for field in ("gainprm", "biasprm", "dynprm", "gear", "forcerange", "forcelimited", "ctrlspec", "trnid"):
        values = getattr(found, f"actuator_{field}"), getattr(expected, f"actuator_{field}")
        np.testing.assert_allclose(*values, rtol=1e-12, err_msg=field)
    np.testing.assert_array_equal(found.dof_armature, expected.dof_armature)


def test_declared_windings_equal_those_of_the_model(tmp_path):
    found, expected = nominal_windings(load_robot(declared(tmp_path))), nominal_windings(SPEC)
    for field in ("resistance", "alpha", "reference_c", "to_housing", "capacity", "constant"):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field), err_msg=field)


def test_joint_stiffness_equals_that_of_its_drive(tmp_path):
    """Weight over what it sags, at rest: kp of the joint. The torque that slows it down: kd."""
    spec = load_robot(declared(tmp_path))
    model = model_mujoco.load_mujoco(spec)
    model.dof_frictionloss[:] = model.dof_damping[:] = 0.0
    data, home = mujoco.MjData(model), SPEC.joint_array("q_home")
    data.qpos[:] = home + 0.3
    data.ctrl.reshape(-1, 3)[:, 0] = 101.0 * (home + 0.3)
    for _ in range(5000):
        mujoco.mj_step(model, data)
    sag = home + 0.3 - data.qpos
    stiff = np.array([40804.0] * 3 + [4080.4] * 3)
    np.testing.assert_allclose(data.qfrc_bias, stiff * sag, rtol=0.02, atol=0.05)
    assert np.abs(data.qfrc_bias).max() > 20.0
    data.qpos[:], data.qvel[:], data.act[:] = home, 0.001, 0.0
    data.ctrl.reshape(-1, 3)[:] = np.stack((101.0 * home, np.zeros(6), np.full(6, 0.05)), axis=1)
    mujoco.mj_forward(model, data)
    damp = np.array([652.864] * 3 + [122.412] * 3)
    np.testing.assert_allclose(data.qfrc_actuator, 0.05 * 101.0 - damp * 0.001, rtol=1e-9)


def test_actuators_and_keys_of_the_model_are_removed(tmp_path):
    """A vendor's model comes with motors of its own, sensors on them, and keys that set their controls."""
    motor = '<actuator><motor name="m" joint="elbow" ctrlrange="-9 9"/></actuator>'
    own = motor + '<sensor><actuatorfrc actuator="m"/></sensor><keyframe><key ctrl="1"/></keyframe>'
    spec = load_robot(declared(tmp_path, xml=[*VENDOR, ("</mujoco>", own + "</mujoco>")]))
    model = model_mujoco.load_mujoco(spec)
    assert model.nactuator == 6
    assert model.nkey == model.nsensor == 0


def test_drive_bounds_the_torque_of_a_joint_without_a_range(tmp_path):
    drives = {name: text.replace("kp =", "torque_max = 20.0\nkp =") for name, text in DRIVES.items()}
    spec = load_robot(declared(tmp_path, drives, xml=[*VENDOR, ('actuatorfrcrange="-28 28" ', "")]))
    model = model_mujoco.load_mujoco(spec)
    np.testing.assert_array_equal(torque_max(spec), [150.0] * 3 + [20.0] * 3)
    np.testing.assert_array_equal(model.jnt_actfrcrange[:, 1], torque_max(spec))
    np.testing.assert_allclose(model.actuator_forcerange[:, 1] * 101.0, torque_max(spec))


def test_unbounded_torque_is_refused(tmp_path):
    spec = load_robot(declared(tmp_path, xml=[*VENDOR, ('actuatorfrcrange="-28 28" ', "")]))
    words = (
        r"robot\.toml: motors\.size1\.drive\.torque_max: missing, and joint wrist_1 has no actuatorfrcrange"
    )
    with pytest.raises(RobotError, match=words):
        model_mujoco.load_mujoco(spec)


def test_rotor_inertia_comes_from_the_model_or_else_the_drive(tmp_path):
    """In both libraries; a model of which neither says anything would be too light for its drive."""
    drives = {name: text.replace("kp =", "armature = 0.25\nkp =") for name, text in DRIVES.items()}
    light = [*VENDOR, ('armature="1.0201" ', "")]
    spec = load_robot(declared(tmp_path / "both", drives, xml=light))
    expected = [0.25] * 3 + [0.20402] * 3
    np.testing.assert_array_equal(model_mujoco.load_mujoco(spec).dof_armature, expected)
    np.testing.assert_array_equal(load_pinocchio(spec)[0].armature, expected)
    words = r"motors\.size3\.drive\.armature: missing, and joint shoulder_pan has no armature in model\.xml"
    with pytest.raises(RobotError, match=words):
        model_mujoco.load_mujoco(load_robot(declared(tmp_path / "none", xml=light)))


def test_drives_in_both_files_are_refused(tmp_path):
    spec = load_robot(declared(tmp_path, xml=[]))
    with pytest.raises(RobotError, match=r"motors\.size3\.drive: model\.xml has a dcmotor as well"):
        model_mujoco.load_mujoco(spec)


@pytest.mark.parametrize("controller", ["", 'controller="0 0 0.012 0 0 48"', 'controller="-0.4"'])
def test_a_drive_of_the_model_without_stiffness_is_refused(tmp_path, controller):
    """Stops would not hold its joint."""
    soft = load_robot(copy_of_arm(tmp_path, xml=[('controller="0.4 0 0.012 0 0 48"', controller)]))
    words = (
        r"dcmotor of joint 'wrist_1': controller: found kp -?0(\.4)?, expected above 0: stops hold the joint"
    )
    with pytest.raises(RobotError, match=words):
        drive_gains(soft)


def test_a_drive_for_some_motors_only_is_refused(tmp_path):
    folder = declared(tmp_path, {"size3": DRIVES["size3"]})
    assert "motors.size1.drive: missing, but other motors have one" in complaint(folder)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gear = 101.0", "gear = 0.0", "motors.size3.drive.gear"),
        ("kp = 40804.0", "kp = 0.0", "motors.size3.drive.kp"),
        ("kd = 652.864", "kd = -1.0", "motors.size3.drive.kd"),
        ("supply_v = 48.0", "", "motors.size3.drive.supply_v"),
        ("supply_v = 48.0", "supply_v = 48.0\nrotor = 1.0", "motors.size3.drive.rotor"),
    ],
)
def test_a_drive_is_read_strictly(tmp_path, old, new, words):
    text = complaint(declared(tmp_path, {"a": re.sub(old, new, DRIVES["size3"], count=1)}))
    assert words in text


def test_unused_keys_leave_the_digest_unchanged(tmp_path):
    """Policies that were trained before there were drives in robot.toml still know their robot."""
    assert load_robot(copy_of_arm(tmp_path)).digest == SPEC.digest
    assert '"drive"' not in SPEC.model_dump_json(exclude_none=True)
    assert load_robot(declared(tmp_path / "other")).digest != SPEC.digest
