import re

import numpy as np
import pytest

from robots.errors import RobotError
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.robot_file import BODIES_MAX, CONTACTS_MAX, JOINTS_MAX, NEIGHBOURS_MAX, SHAPES_MAX
from robots.sensors import FEET_MAX, check_sensors
from robots.spec import RobotSpec, load_robot
from support.arm6 import ARM, NO_CLEARANCE, NO_TOOL, NO_WORKSPACE, SPEC, complaint, copy_of_arm
from support.paths import TEST_ROBOTS


def test_by_name_and_by_path_are_the_same_robot():
    by_path = load_robot(ARM)
    assert by_path == SPEC
    assert (SPEC.name, SPEC.n, SPEC.dt, SPEC.tool) == ("arm6", 6, 0.005, "tool")
    assert SPEC.folder.is_absolute()
    assert len(set(SPEC.joint_names)) == SPEC.n


WITHOUT = {
    "workspace": NO_WORKSPACE,
    "manipulability": (("singularity = 0.0005", ""),),
    "self_collision": NO_CLEARANCE,
    "tool": NO_TOOL,
}


@pytest.mark.parametrize("capability", WITHOUT)
def test_each_capability_is_optional_on_its_own(tmp_path, capability):
    spec = load_robot(copy_of_arm(tmp_path, toml=WITHOUT[capability]))
    with_tool = {"tool", "workspace", "manipulability"} if capability == "tool" else {capability}
    assert spec.capabilities == SPEC.capabilities - with_tool
    tau = Fleet(spec, 2, collisions=True).torque(*np.zeros((3, 2, spec.n)))
    np.testing.assert_array_equal(tau, Fleet(SPEC, 2).torque(*np.zeros((3, 2, spec.n))))


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        ((('tool = "tool" ', ""),), "workspace: found .*, expected none of a robot without tool"),
        (
            (('tool = "tool" ', ""), *WITHOUT["workspace"]),
            r"margins\.singularity: found 0\.0005, expected none of a robot without tool",
        ),
        (
            (NO_WORKSPACE[0],),
            r"margins\.workspace_m: found 0\.013, expected none of a robot without workspace",
        ),
        ((("workspace_m = 0.013", ""),), r"margins\.workspace_m: missing, expected one of a robot with a"),
    ],
)
def test_a_capability_that_lacks_its_other_half_is_an_error(tmp_path, edits, message):
    assert re.search(message, complaint(copy_of_arm(tmp_path, toml=edits)))


def test_the_digest_of_the_arm_stays():
    """Shipped contracts carry it."""
    assert SPEC.digest == "53ee9fccdc28e48f223a5d2700fbe9b3a2597a9b5bd63f9d523dac9c616ad5ff"


def test_arrays_follow_joint_order():
    assert SPEC.joint_array("q_home").shape == (6,)
    for name in ("q_min", "qdd_max"):
        assert SPEC.joint_array(name).tolist() == [getattr(joint, name) for joint in SPEC.joints]
    expected = [SPEC.motors[joint.motor].housing_capacity_j_per_k for joint in SPEC.joints]
    assert SPEC.motor_array("housing_capacity_j_per_k").tolist() == expected


def test_unknown_robot_names_the_known_ones(tmp_path):
    for robot in ("arm7", tmp_path, tmp_path / "nothing"):
        message = complaint(robot)
        assert str(robot) in message
        assert "arm6" in message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("qdd_max = 9.2", "qdd_mx = 10.3", ["joints.0.qdd_mx", "Extra inputs", "10.3"]),
        ("qdd_max = 9.2", "", ["joints.0.qdd_max", "required"]),
        ("qdd_max = 9.2", "qdd_max = '10.3'", ["joints.0.qdd_max", "number", "'10.3'"]),
        (
            "qdd_max = 9.2",
            "qdd_max = 0",
            ["joints.0.qdd_max", "greater than or equal to 0.000000000001", "found 0"],
        ),
        ("qdd_max = 9.2", "qdd_max = nan", ["joints.0.qdd_max", "finite", "nan"]),
        ("qddd_max = 173.0", "qddd_max = -inf", ["joints.0.qddd_max", "-inf"]),
        (
            "qdd_max = 9.2",
            "qdd_max = 1e-3",
            ["joints.0", "qd_max / qdd_max of shoulder_pan", "at most 100 s"],
        ),
        ("qddd_max = 173.0", "qddd_max = 1e-3", ["qdd_max / qddd_max of shoulder_pan", "at most 100 s"]),
        ("qd_max = 3.14", "qd_max = 1e-3", ["(q_max - q_min) / qd_max of shoulder_pan", "at most 100 s"]),
        ("qd_max = 3.14", "qd_max = 1e308", ["joints.0.qd_max", "1000000000"]),
        ("radius_max = 0.95", "radius_max = 1e160", ["workspace.radius_max", "1000000000", "found 1e+160"]),
        ("z_min = 0.03", "z_min = -1e300", ["workspace.z_min", "-1000000000", "found -1e+300"]),
        ("centre = .*", "centre = [0.0, 1e300, 0.0]", ["workspace.centre.1", "1000000000", "found 1e+300"]),
        ("tool_speed_max = 2.5", "tool_speed_max = 1e300", ["workspace.tool_speed_max", "1000000000"]),
        ("workspace_m = 0.013", "workspace_m = 1e300", ["margins.workspace_m", "1000000000", "found 1e+300"]),
        ("speed = 0.68 ", "speed = 5e-324 ", ["margins.speed", "equal to 0.001", "found 5e-324"]),
        ("resolution = 0.01", "resolution = 5e-324", ["sensors.current.resolution", "found 5e-324"]),
        (
            "housing_resistance_k_per_w = 4.0",
            "housing_resistance_k_per_w = 5e-324",
            ["motors.size3.housing_resistance_k_per_w", "equal to 0.000000000001", "found 5e-324"],
        ),
        (
            "housing_capacity_j_per_k = 1200.0",
            "housing_capacity_j_per_k = 5e-324",
            ["motors.size3.housing_capacity_j_per_k", "equal to 0.000000000001", "found 5e-324"],
        ),
        ("play = .*", "play = 1e300", ["joints.0.play", "1000000000", "found 1e+300"]),
        ("control_hz = 200", "control_hz = 20000", ["rates.control_hz", "10000"]),
        ("control_hz = 200", "control_hz = 200.0", ["rates.control_hz", "integer", "200.0"]),
        ("control_hz = 200", "control_hz = 0", ["rates.control_hz", "greater than 0"]),
        ("physics_hz = 1000", "physics_hz = 900", ["rates", "900", "not a multiple", "200"]),
        ("physics_hz = 1000", "physics_hz = 100", ["rates", "100", "not a multiple", "200"]),
        (
            "physics_hz = 1000",
            "physics_hz = 20200",
            ["rates: physics_hz: found 20200, expected at most 100 times control_hz 200"],
        ),
        ("tool_speed = 0.87", "tool_speed = 1.1", ["margins.tool_speed", "less than or equal to 1", "1.1"]),
        (
            r"\[margins.torque_mode\]",
            "[margins.velocity_mode]\nq_soft_rad = 0.05\n[margins.torque_mode]",
            ["margins: velocity_mode.q_soft_rad 0.05 is not below q_target_rad 0.05"],
        ),
        ("tau = 0.46 ", "tau = 1.1 ", ["margins.tau", "less than or equal to 1", "1.1"]),
        ("q_soft_rad = 0.03", "q_soft_rad = 0.06", ["margins", "q_soft_rad 0.06", "q_target_rad 0.05"]),
        ("physics_hz = 1000", "physics_hz = 2000000000", ["rates.physics_hz", "100000", "2000000000"]),
        ("tracking_rad = 0.10", "tracking_rad = 1e9", ["margins.tracking_rad", "3.14", "1000000000"]),
        ("lost_s = 0.110", "lost_s = 10.0", ["margins.lost_s", "less than or equal to 1", "10"]),
        ("stops_max = 100", "stops_max = 1000000000", ["margins.stops_max", "1000"]),
        ("stops_s = 120.0", "stops_s = 1e300", ["margins.stops_s", "86400"]),
        ("oscillation_hz = 5.0", "oscillation_hz = 30.0", ["margins.oscillation_hz", "20", "30"]),
        ("stale_s = 0.035", "stale_s = 0.2", ["margins", "stale_s 0.2", "lost_s 0.11"]),
        ("q_home = 0.0", "q_home = 1.9", ["joints.0", "q_home of shoulder_pan is 1.9", "1.3"]),
        ("q_home = 0.0", "q_home = -1.3", ["joints.0", "q_home of shoulder_pan", "outside"]),
        ("q_min = -1.3", "q_min = 2.5", ["joints.0", "2.5"]),
        ("q_min = -1.3", "", ["joints.0", "shoulder_pan: found one of q_min and q_max, expected both"]),
        ("q_min = -1.3", "q_min = -inf", ["joints.0.q_min", "finite", "-inf"]),
        ('motor = "size3"', 'motor = "size4"', ["shoulder_pan", "'size4'", "known: size3, size1"]),
        ('name = "arm6"', "name = 6", ["name", "string", "6"]),
        ('name = "arm6"', 'name = "arm6"\nfolder = "/"', ["folder"]),
        ('name = "arm6"', 'name = "arm6"\nfolder = 3', ["folder"]),
        ("delay_s = 0.008", "delay_s = 0.3", ["sensors.encoder.delay_s", "less than 0.25", "0.3"]),
        (
            "delay_s = 0.008",
            "delay_s = 0.032",
            ["encoder.delay_s: found 0.032", "every 0.005 s", "stale_s 0.035"],
        ),
        (
            "rate_hz = 200",
            "rate_hz = 30",
            ["encoder.delay_s: found 0.008", "every 0.0333 s", "stale_s 0.035"],
        ),
        (
            "noise = 0.001",
            "noise = -0.001",
            ["sensors.encoder.noise", "greater than or equal to 0", "-0.001"],
        ),
        ("loss = 0.005", "loss = 0.6", ["sensors.encoder.loss", "0.5", "0.6"]),
        ('unit = "rad"', 'unit = "deg"', ["sensors", "encoder.unit", "found 'deg'", "expected 'rad'"]),
        ('unit = "rad"', "", ["sensors.encoder.unit", "required"]),
        (r'unit = "rad"', 'unit = "rad"\nsites = ["tool"]', ["encoder.sites", "['tool']", "expected none"]),
        (r'sites = \["tool"\]', "", ["force.sites", "found []", "expected one"]),
        (r'sites = \["tool"\]', 'sites = ["tool", "tool"]', ["force.sites", "expected one"]),
        (r"\[sensors.encoder\]", "[sensors.encodr]", ["sensors", "encodr", "'encoder'"]),
        (r"\[sensors.temperature\]", "[sensors.gyro]", ["sensors", "no temperature", "encoder, current"]),
        ("rate_hz = 200", "rate_hz = 400", ["encoder.rate_hz", "found 400", "control_hz 200"]),
        ("resolution = 0.01", "resolution = 50.0", ["sensors.current", "resolution 50.0", "range 40.0"]),
        ("housing_capacity_j_per_k = 1200.0", "housing_capacity = 1200.0", ["motors.size3.housing_capacity"]),
        ("centre = .*", "centre = [0.0, 0.0]", ["workspace.centre"]),
        (
            "housing_soft_c = 70.0",
            "housing_soft_c = 95.0",
            ["motors.size3", "95.0 is not below housing_max_c 90.0"],
        ),
        ("winding_soft_c = 80.0", "winding_soft_c = 0.0", ["winding_soft_c", "or equal to 1", "found 0"]),
        ("housing_soft_c = 70.0", "housing_soft_c = -5.0", ["housing_soft_c", "or equal to 1", "found -5"]),
        ("winding_max_c = 110.0", "winding_max_c = 400.0", ["winding_max_c", "300", "400"]),
        ('source = "estimate: 14 bit.*"', 'source = ""', ["sensors.encoder.source", "at least 1 character"]),
        (
            'source = "estimate: to the room.*"',
            'source = ""',
            ["motors.size3.source", "at least 1 character"],
        ),
        ('source = "as shoulder_pan;.*"', 'source = ""', ["joints.1.source", "at least 1 character"]),
        ("control_hz = 200", "control_hz = [", ["not valid TOML"]),
    ],
)
def test_a_wrong_robot_file_is_one_clear_error(tmp_path, old, new, words):
    folder = copy_of_arm(tmp_path, toml=[(old, new)])
    message = complaint(folder)
    assert message.startswith(str(folder / "robot.toml"))
    for word in words:
        assert word in message


NAMES = {
    "tool": ('tool = "tool"', 'tool = "to\x9bol"'),
    "locked.0": ("\ntool", '\nlocked = ["\x9b"]\ntool'),
    "neighbours.0.1": ("\ntool", '\nneighbours = [["tool", "\x9b"]]\ntool'),
    "may_touch.0.bodies.1": ("\ntool", '\nmay_touch = [{ bodies = ["goal", "\x9b"] }]\ntool'),
    "capsules.0.body": ("\ntool", '\ncapsules = [{ body = "\x9b" }]\ntool'),
    "base.feet.0": ("\ntool", '\nbase = { feet = ["\x9b"] }\ntool'),
    "sensors.encoder.sites.0": ('unit = "rad"', 'unit = "rad"\nsites = ["\x9b"]'),
    "joints.0.name": ('"shoulder_pan"', '"should\u202eer"'),
    "joints.0.motor": ('motor = "size3"', 'motor = "\u2066size3"'),
    "motors.": (r"\[motors\.size3\]", '[motors."size\x9b3"]'),
}


@pytest.mark.parametrize("field", NAMES)
def test_a_name_that_could_control_a_terminal_is_refused(tmp_path, field):
    said = complaint(copy_of_arm(tmp_path, toml=[NAMES[field]]))
    assert re.search(rf"robot\.toml: {re.escape(field)}.*: expected printable characters, found '.*\\", said)


@pytest.mark.parametrize("name", ["", "a b", "arm\x9b", "[/x]", "x" * 65])
def test_a_name_of_a_robot_that_no_contract_could_have_is_refused(tmp_path, name):
    said = complaint(copy_of_arm(tmp_path, toml=[('"arm6"', f'"{name}"')]))
    assert re.search(r"robot\.toml: name: String should match pattern .*, found ", said)


def test_a_robot_without_joints(tmp_path):
    folder = copy_of_arm(tmp_path)
    text = (folder / "robot.toml").read_text()
    (folder / "robot.toml").write_text("joints = []\n" + text[: text.index("[[joints]]")])
    assert "joints" in complaint(folder)


def test_a_robot_with_too_many_joints(tmp_path):
    folder = copy_of_arm(tmp_path)
    path = folder / "robot.toml"
    head, *joints = re.split(r"(?m)^(?=\[\[joints\]\])", path.read_text())
    path.write_text(head + joints[1] * (JOINTS_MAX + 1))
    assert re.search(r"robot\.toml: joints: Tuple should have at most 128 items", complaint(folder))


@pytest.mark.parametrize(
    ("key", "item", "most"),
    [
        ("locked", '"a"', JOINTS_MAX),
        (
            "capsules",
            '{body = "a", start = [0.0, 0.0, 0.0], end = [1.0, 0.0, 0.0], radius = 1.0}',
            SHAPES_MAX,
        ),
        ("neighbours", '["a", "b"]', NEIGHBOURS_MAX),
        ("may_touch", '{bodies = ["a", "b"]}', CONTACTS_MAX),
        ("base.feet", '"a"', FEET_MAX),
    ],
)
def test_a_robot_with_lists_that_are_too_long(tmp_path, key, item, most):
    """Each of their names is looked for in the model."""
    line = f"{key} = [{f'{item}, ' * (most + 1)}]\n"
    said = complaint(copy_of_arm(tmp_path, toml=[('tool = "tool"', f'{line}tool = "tool"')]))
    assert re.search(rf"robot\.toml: {key}: Tuple should have at most {most} items", said)


def test_a_robot_with_too_many_motors():
    (_, motor), *_ = SPEC.motors.items()
    more = {f"m{number}": motor for number in range(JOINTS_MAX)}
    with pytest.raises(ValueError, match="motors\n  Dictionary should have at most 128 items"):
        RobotSpec.model_validate({**dict(SPEC), "motors": SPEC.motors | more})


def test_a_contact_sensor_at_too_many_feet():
    quadruped = load_robot("quadruped")
    contact = quadruped.sensors["contact"].model_copy(update={"sites": tuple(map(str, range(FEET_MAX + 1)))})
    with pytest.raises(ValueError, match=r"sensors\.contact\.sites: found .*, expected 1 to 16$"):
        check_sensors(quadruped.sensors | {"contact": contact}, quadruped.rates.control_hz)


def test_a_model_with_too_many_bodies(tmp_path):
    bodies = "<body><inertial mass='1' pos='0 0 0' diaginertia='1 1 1'/></body>" * BODIES_MAX
    spec = load_robot(
        copy_of_arm(tmp_path, xml=[('<body name="forearm_link"', f'{bodies}<body name="forearm_link"')])
    )
    with pytest.raises(RobotError, match=r"model\.xml: found 1007 bodies, expected at most 1000$"):
        Fleet(spec, 1)


def test_a_robot_file_that_is_a_folder(tmp_path):
    folder = copy_of_arm(tmp_path)
    (folder / "robot.toml").unlink()
    (folder / "robot.toml").mkdir()
    assert "robot.toml" in complaint(folder)


def test_digest_does_not_see_layout_and_comments(tmp_path):
    folder = copy_of_arm(tmp_path)
    toml, xml = folder / "robot.toml", folder / "model.xml"
    toml.write_text(
        "# another comment\n\n" + toml.read_text().replace(" = ", "   =  ").replace("\n\n", "\n# c\n\n")
    )
    text = xml.read_text()
    text = re.sub(r"<!--.*?-->", "<!-- said differently -->", text, flags=re.DOTALL)
    text = text.replace(
        '<light pos="1 -1 2.5" dir="-0.4 0.4 -1"', '<light dir="-0.4 0.4 -1"\n  pos="1 -1 2.5"'
    )
    xml.write_text(text.replace(">\n", ">\n\n\t"))
    assert load_robot(folder).digest == SPEC.digest


def _numbers(text):
    """Where every number stands, comments and names left out."""
    blank = re.sub(r"<!--.*?-->|#[^\n]*", lambda m: " " * len(m[0]), text, flags=re.DOTALL)
    return [m.span() for m in re.finditer(r'(?<=[ "=\[])-?\d+\.?\d*(?=[ ",\n\]])', blank)]


@pytest.mark.parametrize("name", ["robot.toml", "model.xml"])
def test_digest_sees_every_number(tmp_path, name):
    folder = copy_of_arm(tmp_path)
    path = folder / name
    text, seen = path.read_text(), {SPEC.digest}
    spans = _numbers(text)
    assert len(spans) > 60
    for start, stop in spans:
        number, is_rate = text[start:stop], re.search(r"(control|physics|rate)_hz = $", text[:start])
        nudged = str(int(number) * 2) if is_rate else repr(float(number) * (1 + 1e-12) + 1e-12)
        path.write_text(text[:start] + nudged + text[stop:])
        try:
            seen.add(load_robot(folder).digest)
        except RobotError as e:  # what cannot be loaded cannot be confused either
            seen.add(f"{e} at {start}")
    assert len(seen) == len(spans) + 1


def test_digest_of_a_missing_or_broken_model(tmp_path):
    folder = copy_of_arm(tmp_path, xml=[("</mujoco>", "")])
    spec = load_robot(folder)
    with pytest.raises(RobotError, match=re.escape(str(folder / "model.xml"))):
        _ = spec.digest
    (folder / "model.xml").unlink()
    with pytest.raises(RobotError, match=re.escape(str(folder / "model.xml"))):
        _ = spec.digest


def test_working_range_lies_inside_the_mechanical_one():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(SPEC.model_path))
    for i, joint in enumerate(SPEC.joints):
        low, high = model.joint(joint.name).range
        assert low < joint.q_min < joint.q_max < high
        assert joint.name == SPEC.joint_names[i]


def test_drives_reach_the_published_torque_at_the_published_speed():
    """The derivation that robot.toml claims: 150 and 28 N·m at 3.14 rad/s on 48 V."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(SPEC.model_path))
    published_speed = np.pi
    for i in range(SPEC.n):
        gear = model.actuator_gear[i, 0]
        resistance, constant = model.actuator_gainprm[i, :2]
        amperes = torque_max(SPEC)[i] / (gear * constant)
        back_emf = constant * gear * published_speed
        assert amperes * resistance + back_emf <= 48.0
        assert back_emf == pytest.approx(31.7, abs=0.05)
        assert amperes == pytest.approx([14.85, 2.77][i >= 3], abs=0.01)
    np.testing.assert_array_equal(torque_max(SPEC), [150, 150, 150, 28, 28, 28])


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        (
            ((r"torque_mode = \{ rate_max = 600.*\}", ""),),
            r"joints\.shoulder_pan\.torque_mode: missing, and its motor has the mode 'torque'",
        ),
        (((r"(?s)\[margins\.torque_mode\].*?(?=\[workspace\])", ""),), r"margins\.torque_mode: missing"),
        (
            ((r'modes = \["position", "velocity", "torque"\]', 'modes = ["current"]'),),
            r"modes\.0: .* found 'current'",
        ),
        (((r"rate_max = 600\.0", "rate_max = -1.0"),), r"torque_mode\.rate_max: .* found -1\.0"),
    ],
)
def test_torque_mode_that_lacks_its_limits_is_an_error(tmp_path, edits, message):
    assert re.search(message, complaint(copy_of_arm(tmp_path, toml=edits)))


def test_what_stands_on_feet_has_no_torque_mode():
    quadruped = load_robot(TEST_ROBOTS / "quadruped")
    motors = {
        name: motor.model_copy(update={"modes": ("torque",)}) for name, motor in quadruped.motors.items()
    }
    with pytest.raises(ValueError, match="modes: found 'torque', expected none of a robot with a base"):
        RobotSpec.model_validate({**dict(quadruped), "motors": motors})


@pytest.mark.parametrize("more", [{"feet": ("front_left", "front_left")}, {"tool": "front_left"}])
def test_a_foot_is_named_once_and_is_not_the_tool(more):
    quadruped = load_robot(TEST_ROBOTS / "quadruped")
    base = quadruped.base.model_copy(update={"feet": more.get("feet", quadruped.base.feet)})
    changed = {**dict(quadruped), "base": base, "tool": more.get("tool")}
    with pytest.raises(ValueError, match=r"base\.feet: found 'front_left' twice, expected each once"):
        RobotSpec.model_validate(changed)
