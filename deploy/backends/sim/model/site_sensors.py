"""MuJoCo sensors of the plant: those of the robot that sit at sites, and the strongest contact for the judge."""

import mujoco

from robots.sensors import KINDS, Kind
from robots.spec import RobotSpec

CONTACT_FORCE, LEVEL = "firstshift/strongest contact", "firstshift/level"


def _name(kind: Kind, site: str) -> str:
    return f"firstshift/{kind}/{site}"


def add_site_sensors(mjcf: mujoco.MjSpec, spec: RobotSpec) -> None:
    """Add the robot's sensors, and a body aligned with gravity if one of them measures orientation."""
    if "orientation" in spec.sensors:
        mjcf.worldbody.add_body(name=LEVEL)
    for kind in spec.sensors:
        if KINDS[kind].mujoco:
            _add_sensor(mjcf, kind, spec)


def _add_sensor(mjcf: mujoco.MjSpec, kind: Kind, spec: RobotSpec) -> None:
    """Add a sensor at each of its sites.

    Force and torque are what the site's body and all that it carries put on its parent; an orientation is relative to a
    body aligned with gravity, which is what an IMU knows.
    """
    measured = getattr(mujoco.mjtSensor, f"mjSENS_{KINDS[kind].mujoco}")
    sites, bodies = ({part.name for part in parts if part.name} for parts in (mjcf.sites, mjcf.bodies))
    for site in spec.sensors[kind].sites:
        spec.check_known(f"sensors.{kind}.sites", site, "sites or bodies", sorted(sites | bodies))
        if site not in sites:  # at the body's origin
            mjcf.body(site).add_site(name=site)
        sensor = mjcf.add_sensor(name=_name(kind, site), type=measured)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, site
        if kind == "orientation":
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_BODY, LEVEL


def add_contact_force(mjcf: mujoco.MjSpec) -> None:
    """Add the force of the strongest contact, in its own frame, whose first axis is the normal."""
    force, strongest, one = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 2, 1
    sensor = mjcf.add_sensor(name=CONTACT_FORCE, type=mujoco.mjtSensor.mjSENS_CONTACT)
    sensor.intprm[:3] = force, strongest, one


def find_site_sensors(model: mujoco.MjModel, spec: RobotSpec) -> dict[Kind, slice]:
    """Return the places of each kind of sensor in `sensordata`."""
    return {kind: _places(model, kind, spec) for kind in spec.sensors if KINDS[kind].mujoco}


def _places(model: mujoco.MjModel, kind: Kind, spec: RobotSpec) -> slice:
    sensors = [model.sensor(_name(kind, site)) for site in spec.sensors[kind].sites]
    return slice(int(sensors[0].adr[0]), int(sensors[-1].adr[0] + sensors[-1].dim[0]))
