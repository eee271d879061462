"""Pinocchio model of a robot, read from MJCF or URDF: locked joints removed, declared capsules added."""

from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from robots.contacts import GOAL, WORLD
from robots.errors import RobotError
from robots.models.files import is_urdf, read_xml, referenced_files, urdf_text
from robots.models.mjcf_places import inherit_places, temporary_model
from robots.robot_file import BODIES_MAX, JOINTS_MAX
from robots.spec import RobotSpec
from robots.tables import Capsule

Read = tuple[pin.Model, pin.GeometryModel]
FLOATING = "JointModelFreeFlyer"
"""Pinocchio's name of the joint of a floating base."""
NO_END = 1e300
"""rad, in place of infinity, which URDF cannot say."""
BODY, SITE = pin.FrameType.BODY, pin.FrameType.OP_FRAME
_SET_ASIDE = "/body"


def read_pinocchio(spec: RobotSpec) -> Read:
    """Return model and collision geometry, not yet compared with robot.toml; a floating base becomes the world.

    Raises:
        RobotError: Pinocchio cannot read the file or would leave a part of it out, or it has no such joint or body.
    """
    path = spec.model_path
    referenced_files(path, spec.folder)
    _check_counts(path)
    try:
        model, geometry = _read_urdf(spec) if is_urdf(path) else _read_mjcf(spec)
    except (ValueError, RuntimeError, LookupError) as e:  # LookupError: a class that it does not know
        raise RobotError(f"{path}: Pinocchio cannot read it: {e!s:.300}") from e
    if spec.locked:
        model, geometry = _lock(spec, model, geometry)
    bodies = _bodies(model)
    for body in {body for pair in spec.neighbours for body in pair}:
        spec.check_known("neighbours", body, "a body", bodies)
    for body in {body for pair in spec.may_touch for body in pair.bodies} - {GOAL, WORLD}:
        spec.check_known("may_touch", body, "a body", bodies)
    if spec.capsules:
        geometry = _capsules(spec, model, geometry)
    _add_rotors(spec, model)
    return _from_base(spec, model, geometry)


def _bodies(model: pin.Model) -> list[str]:
    return [frame.name for frame in model.frames if frame.type == BODY]


def _check_counts(path: Path) -> None:
    """Refuse (RobotError) too many bodies, or joints, locked ones included: Pinocchio takes memory as it reads."""
    root, urdf = read_xml(path), is_urdf(path)
    bodies, joints = (
        root.findall("link" if urdf else "worldbody//body"),
        root.findall("joint" if urdf else "worldbody//joint"),
    )
    if len(bodies) > BODIES_MAX:
        raise RobotError(f"{path}: found {len(bodies)} bodies, expected at most {BODIES_MAX}")
    if (found := sum(joint.get("type") not in ("fixed", "free") for joint in joints)) > JOINTS_MAX:
        raise RobotError(f"{path}: found {found} joints, expected at most {JOINTS_MAX}")


def _read_mjcf(spec: RobotSpec) -> Read:
    path, root = spec.model_path, read_xml(spec.model_path)
    links = len(root.findall("./worldbody/body"))
    if links != 1:
        raise RobotError(
            f"{path}: worldbody holds {links} bodies, expected 1: Pinocchio would leave the others out"
        )
    if (sections := len(root.findall("default"))) > 1:
        raise RobotError(
            f"{path}: default: found {sections} sections, expected at most 1: Pinocchio reads one only"
        )
    carried, shapes = (len(root.findall(f"./worldbody{parts}//geom")) for parts in ("/body", ""))
    # Declared capsules replace all shapes: meshes take seconds to load.
    geometry = not (spec.capsules and carried == shapes)
    if not inherit_places(root):
        return _build_from_mjcf(path, geometry)
    with temporary_model(root, path, spec.folder) as changed:
        return _build_from_mjcf(changed, geometry)


def _build_from_mjcf(path: Path, geometry: bool) -> Read:
    model = pin.buildModelFromMJCF(str(path))
    if not geometry:
        return model, pin.GeometryModel()
    return model, pin.buildGeomFromMJCF(model, str(path), pin.GeometryType.COLLISION)


def _read_urdf(spec: RobotSpec) -> Read:
    text, continuous = _hinges_for_continuous(urdf_text(spec.model_path, spec.folder))
    root = (pin.JointModelFreeFlyer(),) if spec.base else ()
    model = pin.buildModelFromXML(text, *root)
    for place in (model.joints[model.getJointId(name)].idx_q for name in continuous):
        model.lowerPositionLimit[place], model.upperPositionLimit[place] = -np.inf, np.inf
    if spec.capsules:  # they replace all shapes: in URDF, fixed surroundings are links, too
        return model, pin.GeometryModel()
    return model, pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)


def _hinges_for_continuous(text: str) -> tuple[str, list[str]]:
    """Return URDF with hinges in place of continuous joints, which Pinocchio gives two numbers; and their names."""
    root = ElementTree.fromstring(text)
    continuous = [joint for joint in root.iter("joint") if joint.get("type") == "continuous"]
    for joint in continuous:
        joint.set("type", "revolute")
        if (limit := joint.find("limit")) is None:
            limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
        limit.attrib |= {"lower": str(-NO_END), "upper": str(NO_END)}
    return ElementTree.tostring(root, encoding="unicode"), [joint.get("name", "") for joint in continuous]


def _lock(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel) -> Read:
    names = list(model.names)
    for name in spec.locked:
        spec.check_known("locked", name, "joints", names[1:])
    return _without(model, geometry, [names.index(name) for name in spec.locked])


def _without(model: pin.Model, geometry: pin.GeometryModel, joints: list[int]) -> Read:
    # Pinocchio looks for a joint's frame by its name alone, which is often that of its body as well.
    bodies = [frame for frame in model.frames if frame.type == BODY]
    for frame in bodies:
        frame.name += _SET_ASIDE
    reduced, shapes = pin.buildReducedModel(model, geometry, joints, pin.neutral(model))
    for frame in reduced.frames:
        frame.name = frame.name.removesuffix(_SET_ASIDE)
    return reduced, shapes


def _from_base(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel) -> Read:
    """Return the same without the joint of a floating base: the base becomes the world, shapes of the world go."""
    floats = model.njoints > 1 and model.joints[1].shortname() == FLOATING
    if floats != (spec.base is not None):
        found, expected = ("a free joint", "none") if floats else ("no free joint", "one")
        raise RobotError(
            f"{spec.model_path}: found {found} at the root, expected {expected}: robot.toml has"
            f" {'a' if spec.base else 'no'} base"
        )
    if not floats:
        return model, geometry
    for shape in [shape.name for shape in geometry.geometryObjects if shape.parentJoint == 0]:
        geometry.removeGeometryObject(shape)
    return _without(model, geometry, [1])


def tool_frame(spec: RobotSpec, model: pin.Model) -> list[int]:
    """Return the frame of the site or else the body that robot.toml calls the tool; empty without tool.

    Raises:
        RobotError: there is no such site or body.
    """
    return [site_or_body(spec, model, spec.tool, "the tool")] if spec.tool else []


def foot_frames(spec: RobotSpec, model: pin.Model) -> list[int]:
    """Return the frames of the sites or else the bodies that robot.toml calls feet; empty without floating base.

    Raises:
        RobotError: there is no such site or body.
    """
    return [site_or_body(spec, model, foot, "a foot") for foot in (spec.base.feet if spec.base else ())]


def site_or_body(spec: RobotSpec, model: pin.Model, name: str, what: str) -> int:
    """Return the frame of a site or else a body, which robot.toml calls `what`.

    Raises:
        RobotError: there is no such one; `what` is what robot.toml calls it.
    """
    for kind in (SITE, BODY):
        if model.existFrame(name, kind):
            return int(model.getFrameId(name, kind))
    raise RobotError(f"{spec.model_path}: no site or body named {name!r}, which robot.toml calls {what}")


def _add_rotors(spec: RobotSpec, model: pin.Model) -> None:
    for joint, drive in zip(spec.joints, spec.drives, strict=False):
        if drive.armature is not None and model.existJointName(joint.name):
            place = model.joints[model.getJointId(joint.name)].idx_v
            model.armature[place] = model.armature[place] or drive.armature


def _capsules(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel) -> pin.GeometryModel:
    """Return declared capsules instead of the shapes of all bodies; shapes of the world itself stay."""
    shapes = pin.GeometryModel()
    for shape in geometry.geometryObjects:
        if shape.parentFrame == 0:
            shapes.addGeometryObject(shape)
    bodies = _bodies(model)
    for number, capsule in enumerate(spec.capsules):
        spec.check_known(f"capsules.{number}.body", capsule.body, "a body", bodies)
        frame = int(model.getFrameId(capsule.body, BODY))
        body = model.frames[frame]
        place, shape = body.placement * _placement(capsule), coal.Capsule(capsule.radius, _length(capsule))
        name = f"{capsule.body} {number}"
        shapes.addGeometryObject(pin.GeometryObject(name, body.parentJoint, frame, place, shape))
    return shapes


def _length(capsule: Capsule) -> float:
    return float(np.linalg.norm(np.subtract(capsule.end, capsule.start)))


def _placement(capsule: Capsule) -> pin.SE3:
    """Return the middle of a capsule, and the rotation from z to its axis."""
    along = np.subtract(capsule.end, capsule.start)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
    return pin.SE3(turn.toRotationMatrix(), np.add(capsule.start, capsule.end) / 2.0)
