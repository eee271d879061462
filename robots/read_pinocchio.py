"""A robot's model as Pinocchio reads it: MJCF or URDF, without the joints that are locked, with declared capsules."""

import coal
import numpy as np
import pinocchio as pin

from robots.capsule import Capsule
from robots.errors import RobotError
from robots.model_files import is_urdf, read_xml, urdf_text
from robots.spec import RobotSpec

Read = tuple[pin.Model, pin.GeometryModel]
BODY = pin.FrameType.BODY


def read_pinocchio(spec: RobotSpec) -> Read:
    """Model and collision geometry, not yet compared with robot.toml.

    Raises:
        RobotError: Pinocchio cannot read the file or would leave a part of it out, or it has no such joint or body.
    """
    path = spec.model_path
    try:
        model, geometry = _read_urdf(spec) if is_urdf(path) else _read_mjcf(spec)
    except (ValueError, RuntimeError) as e:
        raise RobotError(f"{path}: Pinocchio cannot read it: {e!s:.300}") from e
    if spec.locked:
        model, geometry = _lock(spec, model, geometry)
    for body in {body for pair in spec.neighbours for body in pair}:
        _frame(spec, model, body, "neighbours")
    if spec.capsules:
        geometry = _capsules(spec, model, geometry)
    return model, geometry


def _read_mjcf(spec: RobotSpec) -> Read:
    path = str(spec.model_path)
    links = len(read_xml(spec.model_path).findall("./worldbody/body"))
    if links != 1:
        raise RobotError(
            f"{path}: worldbody holds {links} bodies, expected 1: Pinocchio would leave the others out"
        )
    model = pin.buildModelFromMJCF(path)
    return model, pin.buildGeomFromMJCF(model, path, pin.GeometryType.COLLISION)


def _read_urdf(spec: RobotSpec) -> Read:
    text = urdf_text(spec.model_path, spec.folder)
    model = pin.buildModelFromXML(text)
    return model, pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)


def _lock(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel) -> Read:
    names = list(model.names)
    for name in spec.locked:
        if name not in names[1:]:
            raise RobotError(
                f"{spec.folder / 'robot.toml'}: locked: found {name!r}, expected joints of {spec.model_path.name}:"
                f" {', '.join(names[1:])}"
            )
    joints = [names.index(name) for name in spec.locked]
    return pin.buildReducedModel(model, geometry, joints, pin.neutral(model))  # type: ignore[no-any-return]


def _capsules(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel) -> pin.GeometryModel:
    """Declared capsules in the place of the shapes of all bodies; what stands in the world itself stays."""
    shapes = pin.GeometryModel()
    for shape in geometry.geometryObjects:
        if shape.parentFrame == 0:
            shapes.addGeometryObject(shape)
    for number, capsule in enumerate(spec.capsules):
        frame = _frame(spec, model, capsule.body, f"capsules.{number}.body")
        body = model.frames[frame]
        place, shape = body.placement * _placement(capsule), coal.Capsule(capsule.radius, _length(capsule))
        name = f"{capsule.body} {number}"
        shapes.addGeometryObject(pin.GeometryObject(name, body.parentJoint, frame, place, shape))
    return shapes


def _length(capsule: Capsule) -> float:
    return float(np.linalg.norm(np.subtract(capsule.end, capsule.start)))


def _placement(capsule: Capsule) -> pin.SE3:
    """Middle, and a rotation from z to the capsule's axis."""
    along = np.subtract(capsule.end, capsule.start)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
    return pin.SE3(turn.toRotationMatrix(), np.add(capsule.start, capsule.end) / 2.0)


def _frame(spec: RobotSpec, model: pin.Model, body: str, field: str) -> int:
    if not model.existFrame(body, BODY):
        known = ", ".join(frame.name for frame in model.frames if frame.type == BODY)
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: {field}: found {body!r}, expected a body of {spec.model_path.name}: {known}"
        )
    return int(model.getFrameId(body, BODY))
