"""Nominal model of a robot in Pinocchio, checked against robot.toml."""

import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.errors import RobotError
from robots.models.pinocchio_model import foot_frames, read_pinocchio, site_or_body, tool_frame
from robots.sensors import Kind
from robots.spec import RobotSpec
from robots.tables import Base

HINGES = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
"""Pinocchio's names of a hinge, by its axis."""
TURNED_RAD = 1e-3
"""rad by which the IMU's axes may differ from the base's: the rounding of a file, no mounting."""
AT_THE_IMU: tuple[Kind, ...] = ("gyro", "accelerometer", "orientation")


def load_pinocchio(spec: RobotSpec) -> tuple[pin.Model, pin.GeometryModel]:
    """Build model and collision geometry; of a robot with a floating base, in the frame of its root body.

    Raises:
        RobotError: Pinocchio cannot read the file or would leave a part of it out; a joint is no hinge; joints, tool
            or feet are not those of robot.toml.
    """
    model, geometry = read_pinocchio(spec)
    _check_parts(spec, model)
    for joint, low, high in zip(spec.joints, model.lowerPositionLimit, model.upperPositionLimit, strict=True):
        if not low <= joint.q_min < joint.q_max <= high:
            raise RobotError(
                f"{spec.folder / 'robot.toml'}: joints.{joint.name}: working range [{joint.q_min}, {joint.q_max}]"
                f" is not inside the mechanical [{low:.4f}, {high:.4f}] of {spec.model_path.name}"
            )
    return model, geometry


def _check_parts(spec: RobotSpec, model: pin.Model) -> None:
    path = str(spec.model_path)
    found = tuple(model.names[1:])
    if found != spec.joint_names:
        raise RobotError(f"{path}: joints are {found}; robot.toml lists {spec.joint_names}")
    for joint in model.joints[1:]:
        if joint.shortname() not in HINGES:
            raise RobotError(
                f"{path}: joint {model.names[joint.id]!r} is {joint.shortname()}, expected a hinge"
            )
    tool_frame(spec, model)
    foot_frames(spec, model)
    if spec.base:
        _check_height(spec, spec.base, model)
        _check_contacts(spec, spec.base, model)


def torque_max(spec: RobotSpec) -> Floats:
    """Return (n,) N·m, each joint's `actuatorfrcrange` in the model, or its drive's where the model has none.

    Raises:
        RobotError: a joint has none.
    """
    limit = np.array(load_pinocchio(spec)[0].upperEffortLimit)
    for joint, drive in enumerate(spec.drives):
        if drive.torque_max is not None and not 0 < limit[joint] < np.inf:
            limit[joint] = drive.torque_max
    if not np.isfinite(limit).all():
        names = [name for name, value in zip(spec.joint_names, limit, strict=True) if not np.isfinite(value)]
        raise RobotError(f"{spec.model_path}: no actuatorfrcrange on joints {', '.join(names)}")
    return limit


def imu_in_base(spec: RobotSpec, model: pin.Model) -> Floats:
    """Return (3,) m, the IMU in the frame of the root body, which is that of `model`.

    Raises:
        RobotError: its sensors have several sites, or one that moves with a joint or is turned.
    """
    places = {kind: spec.sensors[kind].sites[0] for kind in AT_THE_IMU if kind in spec.sensors}
    for kind, site in places.items():
        if site != places["gyro"]:
            _refuse(spec, f"{kind}.sites: found {site!r}, expected {places['gyro']!r}, where the gyro is")
    site = places["gyro"]
    frame = model.frames[site_or_body(spec, model, site, "the IMU")]
    if frame.parentJoint:
        moved_by = model.names[frame.parentJoint]
        _refuse(spec, f"gyro.sites: {site!r} moves with {moved_by!r}, expected a site of the base itself")
    turned = float(np.linalg.norm(pin.log3(frame.placement.rotation)))
    if turned > TURNED_RAD:
        expected = "the axes of the root body: let the driver turn its readings"
        _refuse(spec, f"gyro.sites: {site!r} is turned by {turned:.3g} rad, expected {expected}")
    return np.array(frame.placement.translation)


def height_at_home(spec: RobotSpec, model: pin.Model) -> float:
    """Return m, of the IMU above the lowest foot in the home pose of an upright robot.

    Raises:
        RobotError: as `imu_in_base`.
    """
    data = model.createData()
    pin.framesForwardKinematics(model, data, spec.joint_array("q_home"))
    lowest = min(data.oMf[foot].translation[2] for foot in foot_frames(spec, model))
    return float(imu_in_base(spec, model)[2] - lowest)


def _check_height(spec: RobotSpec, base: Base, model: pin.Model) -> None:
    """Refuse (RobotError) a robot that would count as fallen where it stands."""
    height = height_at_home(spec, model)
    if base.height_min_m >= height:
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: base.height_min_m: found {base.height_min_m:g}, expected less than"
            f" {height:.3g} m, the height of the IMU above the lowest foot in the home pose"
        )


def _check_contacts(spec: RobotSpec, base: Base, model: pin.Model) -> None:
    """Refuse (RobotError) contact sensors that are not one at each foot, in the order of the feet."""
    if "contact" not in spec.sensors:
        return
    sites = spec.sensors["contact"].sites
    joints = [model.frames[site_or_body(spec, model, site, "a contact sensor")].parentJoint for site in sites]
    if joints != [model.frames[foot].parentJoint for foot in foot_frames(spec, model)]:
        _refuse(
            spec,
            f"contact.sites: found {list(sites)}, expected one at each of {list(base.feet)}, in that order",
        )


def _refuse(spec: RobotSpec, what: str) -> None:
    raise RobotError(f"{spec.folder / 'robot.toml'}: sensors.{what}")
