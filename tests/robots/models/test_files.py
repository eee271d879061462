import re

import numpy as np
import pinocchio as pin
import pytest

from robots.errors import RobotError
from robots.models import files as model_files
from robots.models.collisions import collision_pairs
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.models.pinocchio_model import read_pinocchio
from robots.spec import RobotSpec, load_robot
from support.arm6 import SPEC, complaint, copy_of_arm
from support.robots.model_files import TETRAHEDRON, two_links, write_stl

mujoco = pytest.importorskip("mujoco")
model_mujoco = pytest.importorskip("robots.models.mujoco_model")


def with_a_wheel(folder):
    """The robot of two links with an elbow that has no ends."""
    folder = two_links(folder, edits=(("q_min = 0.3\nq_max = 1.9\n", ""),))
    path, turns = folder / "two.urdf", '<joint name="elbow" type="continuous">'
    text = path.read_text().replace('<joint name="elbow" type="revolute">', turns)
    path.write_text(text.replace('<limit lower="-2" upper="2" effort="20"', '<limit effort="20"'))
    return folder


@pytest.mark.parametrize("robot", [two_links, with_a_wheel])
def test_urdf_loads_alike_in_pinocchio_and_mujoco(tmp_path, robot):
    """Joints, torque ranges, mass matrix, weight and tool: everything that is computed from the model."""
    spec = load_robot(robot(tmp_path))
    model = model_mujoco.load_mujoco(spec)
    data, (arm, _) = mujoco.MjData(model), load_pinocchio(spec)
    arm_data, rng, dense = arm.createData(), np.random.default_rng(0), np.zeros((2, 2))
    assert [model.joint(i).name for i in range(model.njnt)] == list(arm.names)[1:] == list(spec.joint_names)
    np.testing.assert_array_equal(torque_max(spec), [40.0, 20.0])
    np.testing.assert_array_equal(model.jnt_actfrcrange[:, 1], [40.0, 20.0])
    for _ in range(50):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, (2, 2))
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        mass = pin.crba(arm, arm_data, data.qpos)
        np.testing.assert_allclose(np.triu(mass) + np.triu(mass, 1).T, dense, atol=1e-12)
        bias = pin.nonLinearEffects(arm, arm_data, data.qpos, data.qvel)
        np.testing.assert_allclose(bias, data.qfrc_bias, atol=1e-12)
        pin.framesForwardKinematics(arm, arm_data, data.qpos)
        place, site = arm_data.oMf[arm.getFrameId("tip")], data.site("tip")
        np.testing.assert_allclose(place.translation, site.xpos, atol=1e-12)
        np.testing.assert_allclose(place.rotation.ravel(), site.xmat, atol=1e-12)


def test_a_joint_without_ends_must_be_one_in_the_model(tmp_path):
    spec = load_robot(with_a_wheel(tmp_path))
    model, _ = load_pinocchio(spec)
    np.testing.assert_array_equal(model.upperPositionLimit, [2.0, np.inf])
    np.testing.assert_array_equal(spec.joint_array("q_min"), [spec.joints[0].q_min, -np.inf])
    np.testing.assert_allclose(np.diff(spec.pose_range, axis=0)[0, 1], 2 * np.pi)
    path = spec.folder / "two.urdf"
    path.write_text(
        path.read_text()
        .replace("continuous", "revolute")
        .replace('effort="20"', 'lower="-2" upper="2" effort="20"')
    )
    with pytest.raises(
        RobotError, match=r"joints\.elbow: working range \[-inf, inf\] is not inside .*\[-2\.0000, 2"
    ):
        load_pinocchio(load_robot(spec.folder))


def test_fleet_of_a_urdf_robot_has_its_tool(tmp_path):
    fleet = Fleet(load_robot(two_links(tmp_path)), 3, collisions=True)
    kinematics = fleet.kinematics(np.array([[0.0, 0.5], [0.0, 1.0], [0.5, 1.5]]))
    assert len({tuple(tool) for tool in kinematics.tool_position.round(6)}) == 3
    assert not kinematics.colliding.any()


def test_digest_covers_files_named_by_the_model(tmp_path):
    spec = load_robot(two_links(tmp_path))
    before, mesh = spec.digest, spec.folder / "meshes" / "fore.stl"
    assert model_files.referenced_files(spec.model_path, spec.folder) == (mesh,)
    write_stl(mesh, points=(*TETRAHEDRON[:3], (0.0, 0.0, 0.3)))
    assert spec.digest != before


def test_mjcf_meshes_follow_the_compiler_settings(tmp_path):
    asset = '<compiler meshdir="meshes"/><asset><mesh file="part.stl"/></asset><worldbody>'
    folder = copy_of_arm(tmp_path, xml=[("<worldbody>", asset)])
    write_stl(folder / "meshes" / "part.stl")
    spec = load_robot(folder)
    assert model_files.referenced_files(spec.model_path, spec.folder) == (folder / "meshes" / "part.stl",)
    assert model_mujoco.load_mujoco(spec).nmesh == 1


@pytest.mark.parametrize(
    ("element", "said"),
    [
        ('<include file="more.xml"/>', "include: found 'more.xml'"),
        ('<asset><model name="m" file="model.xml"/></asset>', "model: found 'm model.xml'"),  # MuJoCo crashes
        ('<worldbody><replicate count="300000000"/></worldbody>', "replicate: found '300000000'"),  # for ever
    ],
)
def test_a_model_in_more_than_one_file_or_with_parts_that_are_not_written_out_is_refused(
    tmp_path, element, said
):
    """Pinocchio would pass over them, and not say so."""
    folder = copy_of_arm(tmp_path, xml=[("<worldbody>", f"{element}<worldbody>")])
    (folder / "more.xml").write_text("<mujoco/>")
    spec = load_robot(folder)
    for reader in (load_pinocchio, model_mujoco.load_mujoco, lambda spec: spec.digest):
        with pytest.raises(RobotError, match=rf"model\.xml: {re.escape(said)}, expected a model in one file"):
            reader(spec)


def test_a_model_that_two_parsers_read_differently_is_refused(tmp_path):
    """Other physics in what is a text for one of them, under the digest of the honest model."""
    other = "<mujoco><option gravity='0 0 -4321'/></mujoco>"
    folder = copy_of_arm(tmp_path)
    path = folder / "model.xml"
    path.write_text(f'<!DOCTYPE mujoco [<!ENTITY x ">{other}<!-- ">]><!-- -->{path.read_text()}')
    spec = load_robot(folder)
    for reader in (load_pinocchio, model_mujoco.load_mujoco, lambda spec: spec.digest):
        with pytest.raises(RobotError, match=r"model\.xml: not readable as XML: found <!DOCTYPE mujoco>"):
            reader(spec)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<mujoco model", '<mujoco xmlns="x" model'),
        ("<worldbody>", '<include xmlns="x" file="more.xml"/><worldbody>'),
        ("</worldbody>", '<replicate xmlns="x" count="2"/></worldbody>'),
    ],
)
def test_an_element_that_a_namespace_hides_is_refused(tmp_path, old, new):
    """MuJoCo ignores it, and would read what checks of names do not see."""
    folder = copy_of_arm(tmp_path)
    path = folder / "model.xml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    spec = load_robot(folder)
    for reader in (load_pinocchio, model_mujoco.load_mujoco, lambda spec: spec.digest):
        with pytest.raises(
            RobotError, match=r"model\.xml: not readable as XML: found xmlns='x', expected none"
        ):
            reader(spec)


def test_names_of_what_is_added_to_a_model_are_refused(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text('<mujoco><worldbody><body name="firstshift/payload"/></worldbody></mujoco>')
    said = "found the name 'firstshift/payload', expected none that begins with 'firstshift/'"
    with pytest.raises(RobotError, match=rf"model\.xml: not readable as XML: {said}"):
        model_files.read_xml(path)


@pytest.mark.parametrize("space", ["\t", "\n", " "])
@pytest.mark.parametrize("place", ["file", "meshdir"])
def test_white_space_in_the_name_of_a_file_is_refused(tmp_path, place, space):
    """Of a tab or the end of a line, Python's parser makes a space, and MuJoCo's does not."""
    path = tmp_path / "model.xml"
    values = {"file": "a.obj", "meshdir": "meshes"} | {place: f"a{space}b"}
    compiler, mesh = f'<compiler meshdir="{values["meshdir"]}"/>', f'<mesh file="{values["file"]}"/>'
    path.write_text(f"<mujoco>{compiler}<asset>{mesh}</asset></mujoco>")
    with pytest.raises(RobotError, match=r"model\.xml: file: found white space in 'a b', expected none$"):
        model_files.referenced_files(path, tmp_path)


def test_a_model_is_read_as_utf8_whatever_it_declares(tmp_path):
    """As MuJoCo does."""
    path = tmp_path / "model.xml"
    (tmp_path / "é.obj").touch()
    text = '<?xml version="1.0" encoding="latin-1"?><mujoco><asset><mesh file="é.obj"/></asset></mujoco>'
    path.write_text(text, encoding="utf-8")
    assert model_files.referenced_files(path, tmp_path) == (tmp_path / "é.obj",)
    path.write_text(text, encoding="latin-1")
    with pytest.raises(RobotError, match=r"model\.xml: not readable as XML: not well-formed"):
        model_files.referenced_files(path, tmp_path)


def test_a_second_section_of_defaults_is_refused(tmp_path):
    """MuJoCo merges them."""
    folder = copy_of_arm(tmp_path, xml=[("<worldbody>", "<default><geom margin='0'/></default><worldbody>")])
    with pytest.raises(RobotError, match=r"model.xml: default: found 2 sections, expected at most 1"):
        load_pinocchio(load_robot(folder))


def test_a_class_that_pinocchio_does_not_find_is_refused(tmp_path):
    """MuJoCo calls the class of all others main, even if the file gives it no name."""
    folder = copy_of_arm(
        tmp_path, xml=[('name="shoulder_pan" class="size3"', 'name="shoulder_pan" class="main"')]
    )
    with pytest.raises(RobotError, match=r"model.xml: Pinocchio cannot read it: "):
        load_pinocchio(load_robot(folder))


@pytest.mark.parametrize(
    ("name", "why"),
    [
        *(
            (name, "it is not inside")
            for name in ("../outside.stl", "package://../../outside.stl", "/etc/passwd")
        ),
        *((name, "there is none") for name in ("meshes/no.stl", "")),
    ],
)
def test_a_mesh_outside_of_the_folder_is_refused(tmp_path, name, why):
    folder = two_links(tmp_path)
    write_stl(tmp_path / "outside.stl")
    path = folder / "two.urdf"
    path.write_text(path.read_text().replace("package://two_description/meshes/fore.stl", name))
    spec = load_robot(folder)
    for reader in (load_pinocchio, model_mujoco.load_mujoco, lambda spec: spec.digest):
        with pytest.raises(
            RobotError,
            match=re.escape(f"two.urdf: file: found {name!r}, expected a file inside {folder}: {why}"),
        ):
            reader(spec)


def mjcf_of(folder, compilers, names):
    """A model that names files, which are looked for in the folder of each of its compilers."""
    (folder / "m.stl").write_bytes(b"")
    head = '<compiler meshdir="."/>' * compilers
    meshes = "".join(f'<mesh name="{number}" file="{name}"/>' for number, name in enumerate(names))
    path = folder / "model.xml"
    path.write_text(f"<mujoco>{head}<asset>{meshes}</asset></mujoco>")
    return path


def test_each_file_is_looked_for_once(tmp_path, monkeypatch):
    looked, find_file = [], model_files.find_file
    monkeypatch.setattr(model_files, "find_file", lambda *each: looked.append(each[0]) or find_file(*each))
    found = model_files.referenced_files(mjcf_of(tmp_path, 2, ["m.stl"] * 1000), tmp_path)
    assert (looked, found) == (["m.stl"], (tmp_path / "m.stl",))


@pytest.mark.parametrize(
    ("compilers", "names", "words"),
    [
        (11, ["m.stl"], "found 11 elements compiler, expected at most 10"),
        (
            1,
            [f"{'./' * number}m.stl" for number in range(1001)],
            "names more than 1000 files, expected at most",
        ),
    ],
)
def test_files_of_a_model_are_not_looked_for_without_end(tmp_path, compilers, names, words):
    with pytest.raises(RobotError, match=rf"model\.xml: {words}"):
        model_files.referenced_files(mjcf_of(tmp_path, compilers, names), tmp_path)


@pytest.mark.parametrize(
    ("bound", "words"),
    [
        ("TEXT_BYTES_MAX", r"two\.urdf: found \d+ bytes, at most 1"),
        ("FILES_MAX", r"two\.urdf: names 2 files, expected at most 1"),
        ("FILES_BYTES_MAX", r"two\.urdf: names files of 568 bytes, expected at most 1"),
    ],
)
def test_a_model_is_bounded_before_it_is_read(tmp_path, monkeypatch, bound, words):
    folder = two_links(tmp_path)
    write_stl(folder / "meshes" / "more.stl")
    path, box = folder / "two.urdf", '<box size="0.1 0.1 0.1"/>'
    path.write_text(path.read_text().replace(box, '<mesh filename="meshes/more.stl"/>'))
    spec = load_robot(folder)
    monkeypatch.setattr(model_files, bound, 1)
    for reader in (load_pinocchio, model_mujoco.load_mujoco, lambda spec: spec.digest):
        with pytest.raises(RobotError, match=words):
            reader(spec)


@pytest.mark.parametrize(
    "name", ["../model.xml", "/model.xml", "a/../../model.xml", "model.txt", ".xml", "a//b.xml"]
)
def test_a_model_is_a_file_of_the_folder(tmp_path, name):
    folder = copy_of_arm(tmp_path, toml=[('tool = "tool"', f'tool = "tool"\nmodel = "{name}"')])
    assert "robot.toml: model: " in complaint(folder)


def test_locked_joints_and_their_actuators_are_removed(tmp_path):
    """As in a vendor's hand: two fingers on a tendon, coupled, with an actuator; their mass stays."""
    finger = (
        '<body name="{0}"><joint name="{0}" type="slide" axis="1 0 0"/><geom size="0.01" mass="0.5"/></body>'
    )
    hand = finger.format("left") + finger.format("right") + '<site name="tool"'
    coupled = (
        '<tendon><fixed name="both"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed></tendon>'
        '<equality><joint joint1="left" joint2="right"/></equality>'
        '<actuator><motor tendon="both"/><motor joint="left"/></actuator><contact>'
    )
    locked = [('tool = "tool"', 'tool = "tool"\nlocked = ["left", "right"]')]
    spec = load_robot(
        copy_of_arm(tmp_path, toml=locked, xml=[('<site name="tool"', hand), ("<contact>", coupled)])
    )
    model, (arm, _) = model_mujoco.load_mujoco(spec), load_pinocchio(spec)
    assert (model.njnt, model.ntendon, model.neq, model.nactuator, arm.nq) == (6, 0, 0, 6, 6)
    wrist = pin.computeTotalMass(arm) - pin.computeTotalMass(load_pinocchio(SPEC)[0])
    assert wrist == pytest.approx(1.0)
    data = mujoco.MjData(model)
    data.qpos[:] = SPEC.joint_array("q_home")
    mujoco.mj_forward(model, data)
    weight = pin.computeGeneralizedGravity(arm, arm.createData(), data.qpos)
    np.testing.assert_allclose(weight, data.qfrc_bias, atol=1e-10)


def test_missing_or_driven_locked_joint_is_refused(tmp_path):
    spec = load_robot(
        copy_of_arm(tmp_path / "a", toml=[('tool = "tool"', 'tool = "tool"\nlocked = ["thumb"]')])
    )
    for reader in (load_pinocchio, model_mujoco.load_mujoco):
        with pytest.raises(
            RobotError, match=r"locked: found 'thumb', expected joints of model\.xml: shoulder_pan, "
        ):
            reader(spec)
    folder = copy_of_arm(tmp_path / "b", toml=[('tool = "tool"', 'tool = "tool"\nlocked = ["elbow"]')])
    assert "locked: found 'elbow', expected each once and none that is listed in joints" in complaint(folder)


CAPSULE = """[[capsules]]
body = "forearm_link"
start = [0.0, 0.0, 0.007]
end = [-0.3922, 0.0, 0.007]
radius = 0.04

[[capsules]]
body = "base_link"
start = [0.0, 0.0, 0.06]
end = [0.0, 0.0, 0.08]
radius = 0.06

[rates]"""


def test_capsules_replace_the_shapes_of_bodies(tmp_path):
    """Those two are where the model has them, the others gone, and the table stays."""
    spec = load_robot(copy_of_arm(tmp_path, toml=[(r"\[rates\]", CAPSULE)]))
    (arm, shapes), (_, expected) = load_pinocchio(spec), load_pinocchio(SPEC)
    assert [shape.name for shape in shapes.geometryObjects] == ["table", "forearm_link 0", "base_link 1"]
    by_name = {shape.name: shape for shape in expected.geometryObjects}
    for shape, name in zip(shapes.geometryObjects, ("table", "forearm", "base"), strict=True):
        same = by_name[name]
        assert (shape.parentJoint, shape.parentFrame) == (same.parentJoint, same.parentFrame)
        assert shape.geometry == same.geometry
        np.testing.assert_allclose(shape.placement.translation, same.placement.translation, atol=1e-12)
        axis = shape.placement.rotation[:, 2] @ same.placement.rotation[:, 2]
        assert abs(axis) == pytest.approx(1.0)
    assert len(collision_pairs(arm, shapes)) == 2


def test_replaced_shapes_are_not_read(tmp_path):
    """Meshes take seconds: this one cannot be read at all."""
    xml = [
        ("<worldbody>", '<asset><mesh name="hull" file="hull.stl"/></asset><worldbody>'),
        (r'<geom name="table"[^>]*/>', ""),
        ('<geom name="forearm" ', '<geom type="mesh" mesh="hull"/><geom name="forearm" '),
    ]
    spec = load_robot(copy_of_arm(tmp_path, toml=[(r"\[rates\]", CAPSULE)], xml=xml))
    (spec.folder / "hull.stl").write_text("no mesh")
    _, shapes = load_pinocchio(spec)
    assert [shape.name for shape in shapes.geometryObjects] == ["forearm_link 0", "base_link 1"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "forearm_link",
            "forearm",
            "capsules.0.body: found 'forearm', expected a body of model.xml: base_link, ",
        ),
        ("0.08]", "0.06]", "start and end are both"),
        ("radius = 0.04", "radius = 0", "capsules.0.radius"),
    ],
)
def test_invalid_capsule_is_refused(tmp_path, old, new, words):
    with pytest.raises(RobotError, match=re.escape(words)):
        load_pinocchio(load_robot(copy_of_arm(tmp_path, toml=[(r"\[rates\]", CAPSULE.replace(old, new))])))


def test_neighbour_pairs_are_not_checked(tmp_path):
    pair = 'tool = "tool"\nneighbours = [["wrist_3_link", "wrist_1_link"]]'
    spec = load_robot(copy_of_arm(tmp_path, toml=[('tool = "tool"', pair)]))
    arm, shapes = load_pinocchio(spec)
    every, asked = collision_pairs(arm, shapes), collision_pairs(arm, shapes, spec.neighbours)
    left = [{shapes.geometryObjects[i].name for i in pair} for pair in set(every) - set(asked)]
    assert left == [{"wrist_1", "wrist_3"}]
    model, plain = model_mujoco.load_mujoco(spec), model_mujoco.load_mujoco(SPEC)
    assert model.nexclude == plain.nexclude + 1


def test_first_link_may_touch_its_mounting(tmp_path):
    """As in Pinocchio's checks; MuJoCo by itself would see the arm collide wherever it stands."""
    spec = load_robot(copy_of_arm(tmp_path, xml=[("(?s)<contact>.*?</contact>", "")]))
    bare = mujoco.MjModel.from_xml_path(str(spec.model_path))
    for model, touching in (
        (bare, 1),
        (model_mujoco.load_mujoco(spec), 0),
        (model_mujoco.load_mujoco(SPEC), 0),
    ):
        data = mujoco.MjData(model)
        data.qpos[:] = SPEC.joint_array("q_home")
        mujoco.mj_forward(model, data)
        assert data.ncon == touching
        assert model.nexclude == 1 - touching


def test_missing_neighbours_are_refused(tmp_path):
    pair = 'tool = "tool"\nneighbours = [["wrist_3_link", "hand"]]'
    spec = load_robot(copy_of_arm(tmp_path, toml=[('tool = "tool"', pair)]))
    for reader in (read_pinocchio, model_mujoco.load_mujoco):
        with pytest.raises(RobotError, match=r"neighbours: found 'hand', expected a body of model\.xml: "):
            reader(spec)


def test_a_tool_may_be_a_body(tmp_path):
    """Its frame, in both libraries and in the plant."""
    spec = load_robot(copy_of_arm(tmp_path, toml=[('tool = "tool"', 'tool = "wrist_3_link"')]))
    model, (arm, _) = model_mujoco.load_mujoco(spec), load_pinocchio(spec)
    data, arm_data, q = mujoco.MjData(model), arm.createData(), np.full(6, 0.3)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    pin.framesForwardKinematics(arm, arm_data, q)
    np.testing.assert_allclose(data.site("wrist_3_link").xpos, data.body("wrist_3_link").xpos)
    place = arm_data.oMf[arm.getFrameId(spec.tool)]
    np.testing.assert_allclose(place.translation, data.body("wrist_3_link").xpos, atol=1e-12)


def test_unused_options_keep_the_digest():
    """Policies that were trained before such keys still know their robot."""
    keys = {"model", "locked", "capsules", "neighbours"}
    assert keys <= RobotSpec.model_fields.keys()
    assert not keys & SPEC.model_dump(mode="json").keys()


def test_the_number_of_elements_is_bounded(tmp_path):
    path = tmp_path / "keys.xml"
    path.write_text(f"<mujoco>{'<key/>' * (model_files.ELEMENTS_MAX - 1)}</mujoco>")
    assert len(model_files.read_xml(path)) == model_files.ELEMENTS_MAX - 1
    path.write_text(f"<mujoco>{'<key/>' * model_files.ELEMENTS_MAX}</mujoco>")
    with pytest.raises(RobotError, match=r"keys\.xml: found more than 10000 elements, expected at most that"):
        model_files.read_xml(path)


@pytest.mark.parametrize("kind", ["body", "geom"])
def test_a_name_that_could_control_a_terminal_is_refused(tmp_path, kind):
    path = tmp_path / "model.xml"
    path.write_text(f'<mujoco><worldbody><{kind} name="a&#10;b"/></worldbody></mujoco>')
    with pytest.raises(RobotError, match=rf"{kind}: found name 'a\\nb', expected printable characters"):
        model_files.read_xml(path)


@pytest.mark.slow
def test_elements_nested_too_deeply_are_refused(tmp_path):
    path = tmp_path / "deep.urdf"
    path.write_text(f"<robot name='deep'>{'<a>' * 500_000}{'</a>' * 500_000}</robot>")
    with pytest.raises(RobotError, match="nested deeper"):
        model_files.read_xml(path)
