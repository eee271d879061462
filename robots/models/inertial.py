"""Position of the IMU of a floating base, and check of its contact sensors against its feet."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots.errors import RobotError
from robots.models.pinocchio_model import foot_frames, site_or_body
from robots.sensors import Kind
from robots.spec import RobotSpec
from robots.tables import Base

TURNED_RAD = 1e-3
"""rad by which the IMU's axes may differ from the base's: the rounding of a file, no mounting."""
AT_THE_IMU: tuple[Kind, ...] = ("gyro", "accelerometer", "orientation")


def imu_in_base(spec: RobotSpec, model: pin.Model) -> NDArray[np.float64]:
    """Return (3,) m, the IMU in the frame of the root body, whose axes it must have.

    Args:
        spec: a robot with a floating base. model: in the frame of its root body.

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


def check_contacts(spec: RobotSpec, base: Base, model: pin.Model) -> None:
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
