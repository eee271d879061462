"""Places that elements of MJCF inherit from default classes, against MuJoCo, which reads them."""

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from robots.models.mjcf_places import inherit_places, temporary_model
from robots.models.pinocchio_model import read_pinocchio
from robots.spec import ROBOTS, load_robot
from support.robots.model_files import write_stl

mujoco = pytest.importorskip("mujoco")

INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
MODEL = f"""
<mujoco>
  <compiler angle="radian"/>
  <default>
    <geom type="capsule" size="0.02 0.1"/>
    <site pos="0.1 0 0"/>
    <default class="leg">
      <geom euler="0.3 0 0"/>
      <default class="foot"><geom pos="0 0 -0.2"/></default>
    </default>
    <default class="bone"><geom fromto="0 0 0 0 0 -0.2"/></default>
    <default class="turned"><geom quat="0.6 0 0.8 0" pos="0 0.1 0"/></default>
    <default class="hinge"><joint pos="0 0.05 0"/><site pos="0 0 0.3" zaxis="1 0 1"/></default>
  </default>
  <worldbody>
    <body name="a" pos="0 0 1">
      {INERTIAL}
      <joint name="a" class="hinge" axis="1 0 0"/>
      <geom name="main"/>
      <geom name="foot" class="foot"/>
      <geom name="foot, turned" class="foot" euler="0 0.2 0"/>
      <geom name="foot, placed" class="foot" pos="0 0 -0.3"/>
      <geom name="bone" class="bone"/>
      <geom name="leg along a line" class="leg" fromto="0 0 0 0 0.1 0.1"/>
      <geom name="turned" class="turned"/>
      <site name="plain"/>
      <site name="site" class="hinge"/>
      <body name="b" pos="0 0 0.5" childclass="leg">
        {INERTIAL}
        <joint name="b" axis="0 1 0"/>
        <geom name="of the body's class"/>
        <body name="c">
          {INERTIAL}
          <joint name="c" axis="0 1 0" pos="0.1 0 0"/>
          <geom name="of the parent's class"/>
          <geom name="own class" class="foot"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def in_both(folder, text):
    """Both models of a text at three angles: MuJoCo's model and data, Pinocchio's frames and shapes by name."""
    q = np.array([0.3, -0.5, 0.8])
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    (folder / "model.xml").write_text(text)
    root = ElementTree.fromstring(text)
    assert inherit_places(root)
    with temporary_model(root, folder / "model.xml", folder) as path:
        nominal = pin.buildModelFromMJCF(str(path))
        geometry = pin.buildGeomFromMJCF(nominal, str(path), pin.GeometryType.COLLISION)
    nominal_data, placements = nominal.createData(), geometry.createData()
    pin.framesForwardKinematics(nominal, nominal_data, q)
    pin.updateGeometryPlacements(nominal, nominal_data, geometry, placements)
    shapes = dict(zip((shape.name for shape in geometry.geometryObjects), placements.oMg, strict=True))
    frames = {frame.name: place for frame, place in zip(nominal.frames, nominal_data.oMf, strict=True)}
    return model, data, frames, shapes


def test_every_place_is_that_of_mujoco(tmp_path):
    model, data, frames, shapes = in_both(tmp_path, MODEL)
    names = {model.geom(i).name for i in range(model.ngeom)}
    assert len(names) == 10
    assert names == shapes.keys()
    for name, place in shapes.items():
        np.testing.assert_allclose(data.geom(name).xpos, place.translation, atol=1e-12, err_msg=name)
        axis = data.geom(name).xmat.reshape(3, 3)[:, 2]  # a capsule is the same both ways, and around it
        assert abs(axis @ place.rotation[:, 2]) == pytest.approx(1.0, abs=1e-12), name
    for name in ("plain", "site"):
        np.testing.assert_allclose(data.site(name).xpos, frames[name].translation, atol=1e-12, err_msg=name)
        found = data.site(name).xmat.reshape(3, 3)
        np.testing.assert_allclose(found, frames[name].rotation, atol=1e-12, err_msg=name)


def test_a_model_without_inherited_places_is_left_alone():
    root = ElementTree.parse(ROBOTS / "arm6" / "model.xml").getroot()
    before = ElementTree.tostring(root)
    assert not inherit_places(root)
    assert ElementTree.tostring(root) == before


@pytest.mark.parametrize(
    ("compiler", "mesh"),
    [
        ("", "meshes/fore.stl"),
        ('<compiler meshdir="meshes"/>', "fore.stl"),
        ('<compiler strippath="true" assetdir="meshes"/>', "elsewhere/fore.stl"),
    ],
)
def test_a_changed_model_finds_its_meshes(tmp_path, compiler, mesh):
    write_stl(tmp_path / "meshes" / "fore.stl")
    text = MODEL.replace('<geom name="main"/>', '<geom name="main" type="mesh" mesh="fore"/>')
    text = text.replace("<worldbody>", f'<asset><mesh name="fore" file="{mesh}"/></asset><worldbody>')
    (tmp_path / "model.xml").write_text(text.replace('<compiler angle="radian"/>', compiler))
    root = ElementTree.parse(tmp_path / "model.xml").getroot()
    with temporary_model(root, tmp_path / "model.xml", tmp_path) as path:
        assert path.parent != tmp_path
        model = pin.buildModelFromMJCF(str(path))
        shapes = pin.buildGeomFromMJCF(model, str(path), pin.GeometryType.COLLISION).geometryObjects
        found = {shape.name: shape.meshPath for shape in shapes}
    assert found["main"] == str(tmp_path / "meshes" / "fore.stl")
    assert not path.exists()


def test_feet_of_the_quadruped_are_below_its_knees():
    """Their place is in a default class."""
    model, geometry = read_pinocchio(load_robot("quadruped"))
    placements, q = geometry.createData(), np.zeros(model.nq)
    pin.updateGeometryPlacements(model, model.createData(), geometry, placements, q)
    feet = [
        place.translation
        for shape, place in zip(geometry.geometryObjects, placements.oMg, strict=True)
        if shape.name.endswith("_foot")
    ]
    np.testing.assert_allclose(np.array(feet)[:, 2], -0.426, atol=1e-12)
