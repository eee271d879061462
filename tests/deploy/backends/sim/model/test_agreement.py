"""Agreement of both libraries: robots that Pinocchio reads in another way than MuJoCo are refused."""

import re
import shutil

import mujoco
import numpy as np
import pytest

from deploy.backends.sim.model.agreement import check_agreement
from deploy.backends.sim.model.plant_model import build
from robots.distributions import load_distributions
from robots.errors import RobotError
from robots.models import mujoco_model, pinocchio_model
from robots.models.mujoco_model import load_mujoco
from robots.spec import ROBOTS, load_robot
from support.arm6 import copy_of_arm
from support.planar import PLANAR3
from support.quadruped import QUADRUPED
from support.robots.model_files import two_links, write_stl

NAMES = sorted(path.parent.name for path in ROBOTS.glob("*/robot.toml"))


def refusal(spec):
    with pytest.raises(RobotError) as caught:
        check_agreement(spec, load_mujoco(spec))
    return str(caught.value)


@pytest.mark.parametrize("name", NAMES)
def test_shipped_robots_agree(name):
    spec = load_robot(name)
    check_agreement(spec, load_mujoco(spec))


def test_a_model_that_states_too_little_working_memory_gets_enough(tmp_path):
    folder = copy_of_arm(tmp_path)
    path = folder / "model.xml"
    path.write_text(path.read_text().replace("<worldbody>", '<size memory="1K"/><worldbody>', 1))
    spec = load_robot(folder)
    check_agreement(spec, load_mujoco(spec))


def test_a_model_without_room_for_its_contacts_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(mujoco_model, "WORKING_MEMORY", 0)
    spec = load_robot(copy_of_arm(tmp_path, xml=[("<worldbody>", r'<size memory="1K"/>\g<0>')]))
    assert re.fullmatch(
        rf"{re.escape(str(spec.model_path))}: MuJoCo cannot simulate it: mj_stackAlloc: out of memory, .*",
        refusal(spec),
    )


def test_urdf_with_a_mesh_agrees(tmp_path):
    spec = load_robot(two_links(tmp_path))
    check_agreement(spec, load_mujoco(spec))


def test_a_foot_at_the_knee_is_refused(monkeypatch):
    """Pinocchio does not read places of default classes by itself."""
    monkeypatch.setattr(pinocchio_model, "inherit_places", lambda root: False)
    text = refusal(QUADRUPED)
    assert text.startswith(f"{QUADRUPED.model_path}: geom 'FR_foot': found [")
    assert "in MuJoCo and no shape there in Pinocchio" in text


@pytest.mark.parametrize("axes", ["euler='0.3 0 0'", "quat='0.8 0 0.6 0'"])
def test_a_turn_that_pinocchio_leaves_out_is_refused(tmp_path, monkeypatch, axes):
    """Of a box about its middle, which stays where it is."""
    box = f'<default class="turned"><geom type="box" size="0.04 0.05 0.06" {axes}/></default>'
    folder = copy_of_arm(
        tmp_path,
        xml=[
            ('<default class="size3">', f'{box}<default class="size3">'),
            (r'<geom name="wrist_3" [^>]*/>', '<geom name="wrist_3" class="turned"/>'),
        ],
    )
    spec = load_robot(folder)
    check_agreement(spec, load_mujoco(spec))
    monkeypatch.setattr(pinocchio_model, "inherit_places", lambda root: False)
    assert ": geom 'wrist_3': found [" in refusal(spec)


def test_a_mesh_in_a_frame_is_refused(tmp_path):
    folder = copy_of_arm(
        tmp_path,
        xml=[
            ("<worldbody>", '<asset><mesh name="pad" file="pad.stl"/></asset><worldbody>'),
            ('(<site name="tool")', r'<frame pos="0 0 0.1"><geom type="mesh" mesh="pad"/></frame>\1'),
        ],
    )
    write_stl(folder / "pad.stl")
    assert ": shapes: found 9 that touch in MuJoCo and 8: table, base, " in refusal(load_robot(folder))


def test_weight_that_is_compensated_is_refused(tmp_path):
    spec = load_robot(
        copy_of_arm(tmp_path, xml=[('name="forearm_link"', 'name="forearm_link" gravcomp="1"')])
    )
    assert ": weight: 'elbow': found " in refusal(spec)


def test_joints_that_carry_no_weight_agree(tmp_path):
    """Rounding differs where the axes are vertical."""
    folder = tmp_path / "level"
    shutil.copytree(PLANAR3.folder, folder)
    path = folder / "model.xml"
    text = path.read_text()
    path.write_text(
        text.replace('<body name="segment_1"', '<body name="segment_1" euler="1.5707963267948966 0 0"')
    )
    spec = load_robot(folder)
    model = load_mujoco(spec)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qfrc_bias).max() < 1e-12
    check_agreement(spec, model)


def test_mass_that_pinocchio_leaves_out_is_refused_when_the_plant_is_built(tmp_path):
    """A link without inertial has the mass of its shapes, of which Pinocchio leaves out those that touch nothing."""
    folder = copy_of_arm(tmp_path)
    path = folder / "model.xml"
    text = path.read_text()
    link = re.search(r'<body name="forearm_link".*?(<inertial[^>]*/>)', text, re.DOTALL)
    text = text.replace(link[1], '<geom type="sphere" size="0.05" mass="2" contype="0" conaffinity="0"/>')
    path.write_text(text)
    spec = load_robot(folder)
    with pytest.raises(
        RobotError, match=r"model.xml: mass matrix: 'shoulder_lift': found .* kg·m² in MuJoCo and "
    ):
        build(spec, load_distributions(spec).cable)


def test_a_shape_in_a_frame_is_refused(tmp_path):
    """Pinocchio reads nothing that is in a frame."""
    spec = load_robot(copy_of_arm(tmp_path, xml=[(r'(<geom name="forearm".*?/>)', r"<frame>\1</frame>")]))
    assert ": geom 'forearm': found [" in refusal(spec)
