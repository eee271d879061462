"""Attachments of the plant: backlash behind every gear, a payload, a cable, and MuJoCo's sensors."""

from typing import NamedTuple

import mujoco
import numpy as np

from robots.distributions import Cable
from robots.errors import ConfigError
from robots.models.files import OWN
from robots.sensors import KINDS, Kind
from robots.spec import RobotSpec

PAYLOAD, LOAD = f"{OWN}payload", f"{OWN}load"
CABLE, ANCHOR = f"{OWN}cable", f"{OWN}anchor"
BEAM = f"{OWN}beam"
LEVEL = f"{OWN}level"


def backlash_name(joint: str) -> str:
    """Return the name of the backlash hinge of a joint."""
    return f"{OWN}backlash/{joint}"


def add_backlash(joint: mujoco.MjsJoint, nominal: mujoco.MjModel) -> None:
    """Add a second hinge about the same axis, behind the gear, that runs free between two soft stops.

    Source: Isaac Lab's BAM actuators (2025): backlash as a passive hinge. Its stops are as stiff as 1 kHz bears; its
    inertia and damping are those of a gear's last wheel, so small that they only keep it calm: both estimates.
    """
    motor_side = nominal.joint(joint.name)
    hinge = joint.parent.add_joint(
        name=backlash_name(joint.name), type=joint.type, axis=motor_side.axis, pos=motor_side.pos
    )
    hinge.limited, hinge.range, hinge.margin, hinge.ref = True, [-1.0, 1.0], 0.0, 0.0
    hinge.solref_limit, hinge.solimp_limit = [0.004, 1.0], [0.95, 0.99, 0.0005, 0.5, 2.0]
    hinge.armature, hinge.frictionloss, hinge.springref, hinge.springdamper = 1e-3, 0.0, 0.0, [0.0, 0.0]
    hinge.damping, hinge.stiffness = [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]
    hinge.actfrclimited, hinge.actgravcomp = False, False


def add_payload(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, spec: RobotSpec) -> None:
    """Add a massless body at the tool; without a tool on the base that floats, or on the last link of a mounted arm."""
    if spec.tool:
        tool, carrier = nominal.site(spec.tool), mjcf.site(spec.tool).parent
        payload = carrier.add_body(name=PAYLOAD, pos=tool.pos, quat=tool.quat)
    else:
        carrier = mjcf.body(root_body(nominal) if _floats(nominal) else _last_link(nominal, spec))
        carrier.add_site(name=LOAD)
        payload = carrier.add_body(name=PAYLOAD)
    payload.explicitinertial, payload.mass, payload.inertia = True, 0.0, np.zeros(3)


def root_body(model: mujoco.MjModel) -> str:
    """Return the name of the body that the first joint moves."""
    return str(model.body(int(model.jnt_bodyid[0])).name)


def _floats(model: mujoco.MjModel) -> bool:
    return bool(model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE)


def _last_link(model: mujoco.MjModel, spec: RobotSpec) -> str:
    return str(model.body(int(model.jnt_bodyid[model.joint(spec.joint_names[-1]).id])).name)


def add_cable(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, cable: Cable, spec: RobotSpec) -> None:
    """Add a tendon from an anchor above the robot to the link that the cable is plugged into.

    Raises:
        ConfigError: that link is not in model.xml.
    """
    names = [nominal.body(i).name for i in range(nominal.nbody)]
    if cable.link not in names:
        known = ", ".join(filter(None, names))
        raise ConfigError(
            f"{spec.folder / 'draws.toml'}: cable.link: found {cable.link!r}, expected a body of model.xml: {known}"
        )
    mjcf.worldbody.add_site(name=ANCHOR, pos=[0.0, 0.0, cable.above_m])
    plug = mjcf.body(cable.link).add_site(
        name=f"{CABLE}/plug", pos=nominal.body_ipos[names.index(cable.link)]
    )
    tendon = mjcf.add_tendon(name=CABLE)
    tendon.wrap_site(ANCHOR)
    tendon.wrap_site(plug.name)
    # No force between the two lengths: a cable pulls, and never pushes.
    tendon.springlength, tendon.stiffness = [0.0, 1.0], [1.0, 0.0, 0.0]


class Beam(NamedTuple):
    """Beam of a distance sensor: ids of its site and of the body that carries it, and its place in `sensordata`."""

    site: int
    body: int
    place: int


def add_beam(mjcf: mujoco.MjSpec, spec: RobotSpec) -> None:
    """Add a rangefinder where the robot has a distance sensor, at a site of its own that can be turned to the goal.

    Raises:
        RobotError: the sensor's site is neither a site nor a body of model.xml.
    """
    if "distance" not in spec.sensors:
        return
    site = mjcf.site(_ensured_site(mjcf, "distance", spec.sensors["distance"].sites[0], spec))
    # MuJoCo gives a site that begins with its body's axes those axes for ever.
    beam = site.parent.add_site(name=BEAM, pos=site.pos, quat=[0.0, 1.0, 0.0, 0.0])
    sensor = mjcf.add_sensor(name=BEAM, type=mujoco.mjtSensor.mjSENS_RANGEFINDER)
    sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, beam.name
    sensor.intprm[0] = 1 << int(mujoco.mjtRayDataField.mjRAYDATA_DIST)


def find_beam(model: mujoco.MjModel, spec: RobotSpec) -> Beam | None:
    """Return the beam of the distance sensor; None without one."""
    if "distance" not in spec.sensors:
        return None
    site, place = model.site(BEAM).id, int(model.sensor(BEAM).adr[0])
    return Beam(site=site, body=int(model.site_bodyid[site]), place=place)


def _name(kind: Kind, site: str) -> str:
    return f"{OWN}{kind}/{site}"


def add_site_sensors(mjcf: mujoco.MjSpec, spec: RobotSpec) -> None:
    """Add the robot's sensors, and a body aligned with gravity if one of them measures orientation.

    Raises:
        RobotError: a sensor's site is neither a site nor a body of model.xml.
    """
    if "orientation" in spec.sensors:
        mjcf.worldbody.add_body(name=LEVEL)
    for kind in spec.sensors:
        if KINDS[kind].mujoco:
            _add_sensor(mjcf, kind, spec)


def _add_sensor(mjcf: mujoco.MjSpec, kind: Kind, spec: RobotSpec) -> None:
    """Add a sensor at each of its sites.

    Force and torque are those with which its parent holds the site's body and all that it carries; an orientation is
    relative to a body aligned with gravity, which is what an IMU knows.
    """
    measured = getattr(mujoco.mjtSensor, f"mjSENS_{KINDS[kind].mujoco}")
    for site in spec.sensors[kind].sites:
        _ensured_site(mjcf, kind, site, spec)
        sensor = mjcf.add_sensor(name=_name(kind, site), type=measured)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, site
        if kind == "orientation":
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_BODY, LEVEL


def _ensured_site(mjcf: mujoco.MjSpec, kind: Kind, site: str, spec: RobotSpec) -> str:
    """Return the name of a sensor's site; add it at the origin of the body of that name, if it names a body."""
    sites, bodies = ({part.name for part in parts if part.name} for parts in (mjcf.sites, mjcf.bodies))
    spec.check_known(f"sensors.{kind}.sites", site, "sites or bodies", sorted(sites | bodies))
    if site not in sites:
        mjcf.body(site).add_site(name=site)
    return site


def find_site_sensors(model: mujoco.MjModel, spec: RobotSpec) -> dict[Kind, slice]:
    """Return the places of each kind of sensor in `sensordata`."""
    return {kind: _places(model, kind, spec) for kind in spec.sensors if KINDS[kind].mujoco}


def _places(model: mujoco.MjModel, kind: Kind, spec: RobotSpec) -> slice:
    sensors = [model.sensor(_name(kind, site)) for site in spec.sensors[kind].sites]
    return slice(int(sensors[0].adr[0]), int(sensors[-1].adr[0] + sensors[-1].dim[0]))
