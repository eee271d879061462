import errno
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("tomlkit")

import mujoco
import pinocchio as pin

from deploy.backends.sim.robot import SimRobot
from deploy.state import Mode
from eval.judge.limits import load_limits
from policies.robot_init.capsules import enclosing_capsule
from policies.robot_init.cli import cli, init_robot, package_of
from policies.robot_init.permanent_contacts import permanent_contacts
from policies.robot_init.vendor_model import Actuator, read_vendor_model
from robots.errors import OutputError, RobotError
from robots.models.fleet import Fleet
from robots.models.mujoco_model import load_mujoco
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm
from support.paths import TEST_ROBOTS
from support.robot_init import ANSWERS, fill_in, hold
from support.robots.model_files import URDF, write_stl
from support.robots.motors import VENDOR

HOME = SPEC.joint_array("q_home")
ACTING = "".join(
    f'<position joint="{name}" kp="{kp}" kv="{kv}" forcerange="-{tau} {tau}"/>'
    for name, kp, kv, tau in zip(
        SPEC.joint_names, [20000] * 3 + [4000] * 3, [600] * 3 + [90] * 3, [150] * 3 + [28] * 3, strict=True
    )
)
AT_HOME = " ".join(map(str, HOME))
KEY = f'<keyframe><key qpos="{"0 " * 8}"/><key name="home" qpos="{AT_HOME} 0 0"/></keyframe>'
FINGER = '<body name="{0}" pos="0 {1} 0.06"><joint name="{0}" type="slide" range="0 0.02"/>{2}</body>'
INERTIAL = '<inertial pos="0 0 0" mass="0.02" diaginertia="1e-5 1e-5 1e-5"/>'
FINGERS = FINGER.format("left", 0.02, f'{INERTIAL}<geom type="mesh" mesh="pad"/>') + FINGER.format(
    "right", -0.02, '<geom type="box" size="0.01 0.01 0.02" mass="0.05"/>'
)
"""A hand of two fingers, one of them a mesh."""
AS_VENDORS_DO = [
    *VENDOR,
    ("</mujoco>", f"<actuator>{ACTING}</actuator>{KEY}</mujoco>"),
    ("<worldbody>", '<asset><mesh name="pad" file="parts/pad.stl"/></asset><worldbody>'),
    ('<site name="tool"', f'{FINGERS}<site name="tool"'),
    (' actuatorfrcrange="-150 150"', ""),
    (' actuatorfrcrange="-28 28"', ""),
]


def vendors(folder):
    """The arm as a vendor has it: position actuators, a keyframe, a hand, meshes, and no word of motors or sensors."""
    place = copy_of_arm(folder / "source", xml=AS_VENDORS_DO)
    write_stl(place / "parts" / "pad.stl", points=((0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.04)))
    for name in ("robot.toml", "draws.toml", "limits.toml", "README.md"):
        (place / name).unlink()
    (place / "notes.txt").write_text("no part of the model")
    return place / "model.xml"


def test_draft_contains_the_facts_of_the_model(tmp_path):
    out = tmp_path / "mine"
    facts, still_open = init_robot(vendors(tmp_path), out)
    said = tomllib.loads((out / "robot.toml").read_text())
    assert (said["name"], said["model"], said["tool"]) == ("mine", "model.xml", "tool")
    assert said["locked"] == ["left", "right"] == list(facts.locked)
    assert [joint["name"] for joint in said["joints"]] == list(SPEC.joint_names)
    np.testing.assert_allclose([joint["q_home"] for joint in said["joints"]], HOME, atol=1e-6)
    np.testing.assert_allclose(said["joints"][2]["q_max"], np.pi * 0.96, atol=1e-3)
    assert [joint["motor"] for joint in said["joints"]] == ["motor1"] * 3 + ["motor2"] * 3
    drive = said["motors"]["motor1"]["drive"]
    assert (drive["kp"], drive["kd"], drive["torque_max"]) == (20000.0, 600.0, 150.0)
    assert drive["gear"] == drive["resistance_ohm"] == said["motors"]["motor2"]["source"] == "?"
    assert "armature" not in drive
    assert ["base_link", "shoulder_link"] in said["neighbours"]
    assert {capsule["body"] for capsule in said["capsules"]} >= {"left", "right", "forearm_link"}
    assert ("robot.toml motors.motor1.drive", "gear") in still_open
    assert ("limits.toml", "power_w") in still_open


def test_only_what_the_model_names_is_copied(tmp_path):
    model, out = vendors(tmp_path), tmp_path / "mine"
    init_robot(model, out)
    found = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    ours = {"robot.toml", "draws.toml", "limits.toml", "README.md"}
    assert found == {"model.xml", "parts/pad.stl"} | ours
    assert (out / "model.xml").read_bytes() == model.read_bytes()


def test_a_draft_is_refused_with_a_line_for_each_open_field(tmp_path):
    _, still_open = init_robot(vendors(tmp_path), tmp_path / "mine")
    with pytest.raises(RobotError) as caught:
        load_robot(tmp_path / "mine")
    lines = str(caught.value).splitlines()
    assert len(lines) == len([field for file, field in still_open if file.startswith("robot.toml")])
    assert any(line.endswith("robot.toml: joints.elbow.qd_max: still '?', to be filled in") for line in lines)


@pytest.mark.slow
def test_a_filled_in_draft_is_a_robot_that_holds_its_home(tmp_path):
    """Through both libraries, the simulated plant with its draws, and the whole runtime."""
    init_robot(vendors(tmp_path), tmp_path / "mine")
    spec = fill_in(tmp_path / "mine")
    assert load_mujoco(spec).nactuator == spec.n == 6
    np.testing.assert_array_equal(torque_max(spec), [150.0] * 3 + [28.0] * 3)
    assert set(load_limits(spec).motors) == {"motor1", "motor2"}
    runtime, worst = hold(spec, 4.0)
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    assert worst < 0.02


def test_a_drawn_robot_of_a_draft_has_its_cable_on_a_link_of_its_own(tmp_path):
    init_robot(vendors(tmp_path), tmp_path / "mine")
    draws = tomllib.loads((tmp_path / "mine" / "draws.toml").read_text())
    assert draws["cable"]["link"] == "wrist_1_link"
    assert "estimate" in (tmp_path / "mine" / "draws.toml").read_text()


def test_urdf_mesh_paths_follow_its_package(tmp_path):
    """Meshes beside its own folder, speeds of its joints, and the fingers locked."""
    package = tmp_path / "two_description"
    write_stl(package / "meshes" / "fore.stl")
    (package / "urdf").mkdir()
    (package / "package.xml").write_text("<package/>")
    shutil.copy(URDF, package / "urdf" / "two.urdf")
    assert package_of(package / "urdf" / "two.urdf") == package
    out = tmp_path / "mine"
    init_robot(package / "urdf" / "two.urdf", out)
    said = tomllib.loads((out / "robot.toml").read_text())
    assert (said["model"], said["locked"]) == ("urdf/two.urdf", ["grip"])
    assert [joint["qd_max"] for joint in said["joints"]] == [3.0, 3.0]
    assert (out / "meshes" / "fore.stl").is_file()
    spec = fill_in(out, ANSWERS | {"tool": "tip", "q_home": 0.5})
    assert load_mujoco(spec).nactuator == len(load_pinocchio(spec)[0].names) - 1 == 2


def test_a_robot_that_walks_has_a_base_and_no_tool(tmp_path):
    """The quadruped of the tests, whose own robot.toml says the rest."""
    source, out = TEST_ROBOTS / "quadruped", tmp_path / "mine"
    facts, _ = init_robot(source / "model.xml", out)
    assert facts.floating_base
    feet = load_robot(source).base.feet
    said = tomllib.loads((out / "robot.toml").read_text())
    assert not {"tool", "workspace"} & said.keys()
    assert said["sensors"]["gyro"]["sites"] == ["imu"]
    spec = fill_in(out, ANSWERS | {"feet": list(feet), "q_home": -0.4})
    assert spec.joint_names == load_robot(source).joint_names
    assert load_mujoco(spec).nactuator == Fleet(spec, 1, collisions=True).n == 12


def test_urdf_gets_a_free_joint_by_option(tmp_path):
    """URDF has no free joint: both libraries give it one, and agree on its mass and on where its foot is."""
    write_stl(tmp_path / "source" / "meshes" / "fore.stl")
    model = shutil.copy(URDF, tmp_path / "source" / "two.urdf")
    init_robot(Path(model), tmp_path / "mine", walks=True)
    said = tomllib.loads((tmp_path / "mine" / "robot.toml").read_text())
    assert said["sensors"]["gyro"]["sites"] == ["base"]
    spec = fill_in(tmp_path / "mine", ANSWERS | {"feet": ["tip"], "q_home": 1.8})
    model, (arm, _) = load_mujoco(spec), load_pinocchio(spec)
    assert (model.nq, model.nv, model.nactuator, arm.nq) == (9, 8, 2, 2)
    assert model.body_mass.sum() == pytest.approx(4.4)
    data, arm_data = mujoco.MjData(model), arm.createData()
    data.qpos[7:] = 0.5, -0.7
    mujoco.mj_kinematics(model, data)
    pin.framesForwardKinematics(arm, arm_data, data.qpos[7:])
    foot = data.body("tip").xpos - data.body("base").xpos
    np.testing.assert_allclose(arm_data.oMf[arm.getFrameId("tip")].translation, foot, atol=1e-12)
    robot = SimRobot(spec, [robot_seed(3, 0)])
    assert robot.truth().valid.all()


def test_walking_mjcf_needs_a_free_joint(tmp_path):
    with pytest.raises(RobotError, match="found no free joint, expected one"):
        init_robot(vendors(tmp_path), tmp_path / "mine", walks=True)


def test_mesh_outside_the_folder_is_refused(tmp_path):
    model, out = vendors(tmp_path), tmp_path / "mine"
    write_stl(tmp_path / "secret.stl")
    model.write_text(model.read_text().replace("parts/pad.stl", "../../secret.stl"))
    with pytest.raises(RobotError, match=r"file: found '\.\./\.\./secret\.stl', expected a file inside"):
        init_robot(model, out)
    assert not out.exists()


def test_nothing_is_overwritten(tmp_path):
    out = tmp_path / "mine"
    out.mkdir()
    with pytest.raises(OutputError, match="exists already"):
        init_robot(vendors(tmp_path), out)


@pytest.mark.parametrize(
    ("error", "expected", "message"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), 1, "cannot be written: No space left on device"),
        (OSError(errno.EACCES, "Permission denied"), 2, "cannot be written: Permission denied"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_an_interrupted_or_failed_draft_leaves_nothing(call, tmp_path, monkeypatch, error, expected, message):
    model, out = vendors(tmp_path), tmp_path / "robots" / "mine"

    def write_text(*_, **__):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", write_text)
        code, _, said = call(cli, model, "--out", out)
    assert (code, said) == (expected, message and f"error: --out {out}: {message}\n")
    assert list(out.parent.iterdir()) == []
    assert call(cli, model, "--out", out)[0] == 0
    assert [path.name for path in out.parent.iterdir()] == ["mine"]


def test_of_two_drafts_at_once_the_first_is_kept(tmp_path, monkeypatch):
    model, out = vendors(tmp_path), tmp_path / "robots" / "mine"

    def copyfile(source, copy, copyfile=shutil.copyfile):
        out.mkdir(exist_ok=True)
        (out / "first").touch()
        copyfile(source, copy)

    monkeypatch.setattr(shutil, "copyfile", copyfile)
    with pytest.raises(OutputError, match=f"--out {out}: exists already, expected another path"):
        init_robot(model, out)
    assert [path.relative_to(out.parent).as_posix() for path in out.parent.rglob("*")] == [
        "mine",
        "mine/first",
    ]


def test_the_draft_has_the_usual_permissions(tmp_path):
    (tmp_path / "plain").mkdir()
    init_robot(vendors(tmp_path), tmp_path / "mine")
    assert (tmp_path / "mine").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_deleted_working_directory_is_a_place_that_cannot_be_written(call, tmp_path, monkeypatch):
    model = vendors(tmp_path)
    (tmp_path / "deleted").mkdir()
    monkeypatch.chdir(tmp_path / "deleted")
    (tmp_path / "deleted").rmdir()
    expected = "error: --out mine: cannot be written: No such file or directory\n"
    assert call(cli, model, "--out", "mine") == (2, "", expected)


CHAIN = """<mujoco>
  <default><geom type="capsule" size="0.05"/></default>
  <worldbody>
    <body name="one"><joint name="a" range="-60 60"/><geom fromto="0 0 0 0 0 0.3"/>
      <body name="two" pos="0 0 0.3"><joint name="b" axis="1 0 0"/><geom fromto="0 0 0 0 0 0.06"/>
        <body name="three" pos="0 0 0.06"><joint name="c"/><geom type="cylinder" size="0.05 0.05" pos="0 0 0.05"/>
          <body name="four" pos="0 0 0.5">
            <joint name="d" armature="0.1" actuatorfrcrange="-3 3"/><geom type="sphere" size="0.02"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="a" gear="50" ctrllimited="true" ctrlrange="-2 2"/>
    <velocity joint="b" kv="7"/>
    <position joint="d" kp="40" kv="3" gear="2" forcerange="-9 9"/>
  </actuator>
</mujoco>"""
"""Links, one of them short; actuators of every kind, and a joint that none moves."""


def test_actuators_are_converted_to_the_joint_side(tmp_path):
    path = tmp_path / "chain.xml"
    path.write_text(CHAIN)
    a, b, c, d = read_vendor_model(path, tmp_path).joints
    assert (a.low, a.actuator) == (pytest.approx(-np.pi / 3), Actuator(torque_max=100.0, gear=50.0))
    assert (b.low, b.actuator) == (None, Actuator(kd=7.0))
    assert c.actuator is None
    assert (d.torque_range, d.armature) == (3.0, 0.1)
    assert d.actuator == Actuator(gear=2.0, kp=160.0, kd=12.0)
    assert read_vendor_model(path, tmp_path).locked == ("c",)


def test_links_in_permanent_contact_are_neighbours(tmp_path):
    """The first and the third, across the short one; the last is far from both."""
    path = tmp_path / "chain.xml"
    path.write_text(CHAIN)
    assert permanent_contacts(path, tmp_path, read_vendor_model(path, tmp_path)) == (("one", "three"),)
    path.write_text(CHAIN.replace("0 0 0.06", "0 0 0.4"))
    assert permanent_contacts(path, tmp_path, read_vendor_model(path, tmp_path)) == ()


@pytest.mark.parametrize("points", ["box", "cloud", "ball"])
def test_a_capsule_holds_all_points(points):
    """And is no larger than need be: not twice the box that holds them."""
    rng = np.random.default_rng(0)
    cloud = {
        "box": rng.uniform(-1, 1, (500, 3)) * [0.05, 0.3, 0.04],
        "cloud": rng.normal(size=(500, 3)) * [0.1, 0.02, 0.03] + 0.4,
        "ball": rng.normal(size=(500, 3)),
    }[points]
    if points == "ball":
        cloud /= np.linalg.norm(cloud, axis=1, keepdims=True)
    (start, end), radius = enclosing_capsule(cloud)
    along = (end - start) / np.linalg.norm(end - start)
    nearest = start + np.clip((cloud - start) @ along, 0, np.linalg.norm(end - start))[:, None] * along
    distance = np.linalg.norm(cloud - nearest, axis=1)
    assert distance.max() <= radius * (1 + 1e-9)
    assert distance.max() > radius * 0.99
    assert radius < 2 * np.sort(np.ptp(cloud, axis=0))[1]


def test_command_lists_open_fields(call, tmp_path):
    code, text, _ = call(cli, vendors(tmp_path), "--out", tmp_path / "mine")
    assert code == 0
    assert "8 joints, 2 of them locked" in text
    joints = ", ".join(SPEC.joint_names)
    assert f"  robot.toml joints.{joints}: qd_max, qdd_max, qddd_max, source\n" in text


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("nothing.xml", "no file"),
        (f"{'x' * 300}.xml", "no file"),
        ("folder.xml", "a folder"),
        ("mesh.stl", "another kind of file"),
    ],
)
def test_malformed_model_is_reported(call, tmp_path, name, found):
    (tmp_path / "folder.xml").mkdir()
    (tmp_path / "mesh.stl").touch()
    code, _, said = call(cli, tmp_path / name)
    assert code == 2
    assert f"{name}: found {found}, expected a model: MJCF (.xml) or URDF (.urdf)" in said


def test_model_whose_name_is_not_utf8_is_refused(tmp_path):
    model = tmp_path / "v\udcff.xml"
    model.touch()
    with pytest.raises(RobotError, match=r"\.xml: found a name that is not UTF-8$"):
        package_of(model)


@pytest.mark.parametrize("name", ["my robot", "arm.v2", "x" * 65])
def test_a_folder_whose_name_no_robot_can_have_is_refused(call, tmp_path, name):
    write_stl(tmp_path / "meshes" / "fore.stl")
    shutil.copyfile(URDF, tmp_path / "two.urdf")
    code, _, said = call(cli, tmp_path / "two.urdf", "--out", tmp_path / name)
    assert code == 2
    assert f"{name}: found name {name!r}, expected up to 64 letters, digits, - and _" in said
    assert not (tmp_path / name).exists()


def test_speed_of_nan_is_refused(tmp_path):
    write_stl(tmp_path / "meshes" / "fore.stl")
    model = tmp_path / "two.urdf"
    text, count = re.subn(r'velocity="[^"]*"', 'velocity="fast"', URDF.read_text())
    assert count
    model.write_text(text)
    with pytest.raises(RobotError, match="velocity: found 'fast', expected a number"):
        read_vendor_model(model, tmp_path)


@pytest.mark.parametrize("kind", ["joint", "body", "site"])
def test_a_name_of_two_lines_is_refused(tmp_path, kind):
    names = {"joint": "j", "body": "b", "site": "s"} | {kind: "two&#10;lines"}
    model = tmp_path / "arm.xml"
    model.write_text(
        f"<mujoco><worldbody><body name='{names['body']}'><joint name='{names['joint']}'/>"
        f"<geom size='0.1'/><site name='{names['site']}'/></body></worldbody></mujoco>"
    )
    with pytest.raises(RobotError, match=f"{kind}: found name"):
        read_vendor_model(model, tmp_path)


@pytest.mark.parametrize(
    ("body", "count", "what"),
    [
        ('<body name="b{0}"><joint name="j{0}"/><geom size="0.1"/></body>', 101, "101 joints"),
        ('<geom size="0.1" pos="0 0 {0}"/>', 501, "501 shapes that touch"),
    ],
)
def test_more_parts_than_robots_have_are_refused(tmp_path, body, count, what):
    """They take the square of their number, or its cube."""
    many, path = "".join(map(body.format, range(count))), tmp_path / "model.xml"
    path.write_text(
        f'<mujoco><worldbody><body name="a"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{many}</body>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(RobotError, match=f"model.xml: found {what}, expected at most"):
        init_robot(path, tmp_path / "robot")


def test_a_model_that_does_not_compile_within_bounds_is_not_read(tmp_path, monkeypatch):
    def refused(model, folder):
        raise RobotError(f"{model}: too dear")

    monkeypatch.setattr("policies.robot_init.cli.check_compiles", refused)
    with pytest.raises(RobotError, match=r"model\.xml: too dear"):
        init_robot(vendors(tmp_path), tmp_path / "mine")
    assert not (tmp_path / "mine").exists()
