"""What only the plant has: play in its gears, a payload, a cable, sensors. Added to model.xml, neutral until drawn."""

from dataclasses import dataclass

import mujoco
import numpy as np

from robots.arrays import Ints
from robots.distributions import Cable
from robots.errors import ConfigError, RobotError
from robots.models.mujoco_model import load_mujoco, read_mjcf
from robots.sensors import Kind
from robots.spec import RobotSpec
from robots.tables import Base

PLAY, PAYLOAD, CABLE, ANCHOR = "play", "firstshift/payload", "firstshift/cable", "firstshift/anchor"
STRONGEST, SELF = "firstshift/strongest contact", "firstshift/contact with itself"
FLOOR, GANTRY, BACK, LEVEL = "firstshift/floor", "firstshift/gantry", "firstshift/back", "firstshift/level"
"""Names of what is added; a joint's play is called as the joint and this."""

FAR_M = 10.0
"""How far above the floor model.xml may hold a robot."""

SENSORS = {
    "gyro": mujoco.mjtSensor.mjSENS_GYRO,
    "accelerometer": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
    "orientation": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    "force": mujoco.mjtSensor.mjSENS_FORCE,
    "torque": mujoco.mjtSensor.mjSENS_TORQUE,
    "contact": mujoco.mjtSensor.mjSENS_TOUCH,
}
"""Kinds that sit at sites. Force and torque are what the site's body and all that it carries put on its parent; an
orientation is that in a world whose gravity points down, which is what an IMU knows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Anatomy:
    """The plant's model and where its parts are.

    Attributes:
        model: of every simulation.
        joints, play: (n,) joint ids: on the motor's side, and what is left between gear and link.
        bodies: (n,) body ids of the links that the joints move.
        link: (bodies,) the joint that moves a body, rigidly attached ones included; -1 for what does not move.
        payload: body id. cable: tendon id. anchor: site id. tool: site id; of a robot with a base, where its load sits.
        level: id of a body that does nothing but stand as gravity says, however the robot or its floor is tilted; of
            a robot that measures orientation.
        strongest: where in `sensordata` the normal force of the strongest contact is, which only the judge may know.
        base: of a robot that has one.
        sensed: where in `sensordata` each kind of sensor is.
    """

    model: mujoco.MjModel
    joints: Ints
    play: Ints
    bodies: Ints
    link: Ints
    payload: int
    cable: int
    anchor: int
    tool: int
    level: int | None
    strongest: int
    base: "FloatingBody | None"
    sensed: dict[Kind, slice]

    @property
    def addresses(self) -> Ints:
        """(2, 2, n) of [joints, play]: places in [`qpos`, `qvel`]."""
        ids = np.stack((self.joints, self.play))
        places = np.stack((self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]), axis=1)
        return np.asarray(places, dtype=np.int64)

    @property
    def dofs(self) -> Ints:
        """(n,) places of the joints in `qvel`."""
        return np.asarray(self.model.jnt_dofadr[self.joints], dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class FloatingBody:
    """A base on the floor, held by a gantry at first.

    Attributes:
        qpos, qvel: where its seven and six numbers are in the state.
        stands_m: m, its height when the lowest part of the robot at home touches the floor.
        gantry: equality id.
        itself, allowed: where in `sensordata` the number of the robot's contacts with itself is, and that of each
            pair of bodies that may touch.
    """

    qpos: slice
    qvel: slice
    stands_m: float
    gantry: int
    itself: int
    allowed: Ints


def build(spec: RobotSpec, cable: Cable) -> Anatomy:
    """Add to model.xml and compile.

    Raises:
        RobotError: model.xml or a sensor's site makes no sense. ConfigError: the cable's link is not in model.xml.
    """
    nominal, mjcf = load_mujoco(spec), read_mjcf(spec)
    _allow(mjcf)
    for name in spec.joint_names:
        _add_play(mjcf.joint(name), nominal)
    if spec.base:
        _add_ground(mjcf, nominal, spec, spec.base)
    _add_payload(mjcf, nominal, spec)
    _add_cable(mjcf, nominal, cable, spec)
    if "orientation" in spec.sensors:
        mjcf.worldbody.add_body(name=LEVEL)
    for kind in spec.sensors:
        if kind in SENSORS:
            _add_sensor(mjcf, nominal, kind, spec)
    _add_strongest(mjcf)
    model = mjcf.compile()
    # A diverged simulation must be seen, not silently put back to its start.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return _find(model, spec)


def _add_payload(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, spec: RobotSpec) -> None:
    """At the tool; a robot that has none carries it on its back."""
    if spec.tool:
        tool, carrier = nominal.site(spec.tool), mjcf.site(spec.tool).parent
        payload = carrier.add_body(name=PAYLOAD, pos=tool.pos, quat=tool.quat)
    else:
        back = mjcf.body(_root(nominal))
        back.add_site(name=BACK)
        payload = back.add_body(name=PAYLOAD)
    payload.explicitinertial, payload.mass, payload.inertia = True, 0.0, np.zeros(3)


def _root(model: mujoco.MjModel) -> str:
    """Name of the body that the first joint moves."""
    return str(model.body(int(model.jnt_bodyid[0])).name)


def _add_ground(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, spec: RobotSpec, base: Base) -> None:
    """A floor where model.xml has none, and a gantry that holds the base above it until the drives are on."""
    if not _floors(nominal).size:
        mjcf.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    gantry = mjcf.add_equality(name=GANTRY, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    gantry.name1, gantry.name2 = "world", _root(nominal)
    _add_touch(mjcf, SELF, (_root(nominal), _root(nominal)), mujoco.mjtObj.mjOBJ_XBODY)
    bodies = {body.name for body in mjcf.bodies}
    for number, pair in enumerate(base.may_touch):
        if unknown := set(pair) - bodies:
            raise RobotError(
                f"{spec.folder / 'robot.toml'}: base.may_touch: found {unknown.pop()!r}, expected bodies of the model:"
                f" {', '.join(sorted(filter(None, bodies)))}"
            )
        _add_touch(mjcf, f"{SELF} {number}", pair, mujoco.mjtObj.mjOBJ_BODY)


def _add_touch(mjcf: mujoco.MjSpec, name: str, pair: tuple[str, str], kind: mujoco.mjtObj) -> None:
    """How many contacts there are between two bodies, or all that they carry."""
    sensor = mjcf.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT)
    sensor.objtype = sensor.reftype = kind
    sensor.objname, sensor.refname = pair
    found, any_of_them, one = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1
    sensor.intprm[:3] = found, any_of_them, one


def _floors(model: mujoco.MjModel) -> Ints:
    """Ids of planes that are fixed to the world."""
    return np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0))


def _allow(mjcf: mujoco.MjSpec) -> None:
    """Undo what would get in the way of the additions."""
    for key in list(mjcf.keys):
        mjcf.delete(key)  # of another size than the state now has
    mjcf.compiler.fusestatic = False  # the payload stays a body of its own
    for geom in mjcf.geoms:
        geom.condim = max(geom.condim, 3)  # whatever model.xml leaves out, what touches also rubs


def _add_play(joint: mujoco.MjsJoint, nominal: mujoco.MjModel) -> None:
    """A second joint about the same axis, behind the gear, that runs free between two soft stops.

    Source: Isaac Lab's BAM actuators (2025): backlash as a passive hinge. Its stops are as stiff as 1 kHz bears; its
    inertia and damping are those of a gear's last wheel, so small that they only keep it calm: both estimates.
    """
    same = nominal.joint(joint.name)
    play = joint.parent.add_joint(name=f"{joint.name}/{PLAY}", type=joint.type, axis=same.axis, pos=same.pos)
    play.limited, play.range, play.margin, play.ref = True, [-1.0, 1.0], 0.0, 0.0
    play.solref_limit, play.solimp_limit = [0.004, 1.0], [0.95, 0.99, 0.0005, 0.5, 2.0]
    play.armature, play.frictionloss, play.springref, play.springdamper = 1e-3, 0.0, 0.0, [0.0, 0.0]
    play.damping, play.stiffness = [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]
    play.actfrclimited, play.actgravcomp = False, False


def _add_cable(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, cable: Cable, spec: RobotSpec) -> None:
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
    # No force between the two lengths: it pulls, and never pushes.
    tendon.springlength, tendon.stiffness = [0.0, 1.0], [1.0, 0.0, 0.0]


def _add_sensor(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, kind: Kind, spec: RobotSpec) -> None:
    sites, bodies = ({part.name for part in parts if part.name} for parts in (mjcf.sites, mjcf.bodies))
    for site in spec.sensors[kind].sites:
        if site not in sites | bodies:
            raise RobotError(
                f"{spec.folder / 'robot.toml'}: sensors.{kind}.sites: found {site!r}, expected sites or bodies of"
                f" model.xml: {', '.join(sorted(sites | bodies))}"
            )
        if site not in sites:  # at the body's origin
            mjcf.body(site).add_site(name=site)
        sensor = mjcf.add_sensor(
            name=f"firstshift/{kind}/{site}",
            type=SENSORS[kind],
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site,
        )
        if kind == "orientation":
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_BODY, LEVEL


def _add_strongest(mjcf: mujoco.MjSpec) -> None:
    """The force of one contact of all, in its own frame, whose first axis is the normal."""
    force, strongest, one = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 2, 1
    sensor = mjcf.add_sensor(name=STRONGEST, type=mujoco.mjtSensor.mjSENS_CONTACT)
    sensor.intprm[:3] = force, strongest, one


def _find(model: mujoco.MjModel, spec: RobotSpec) -> Anatomy:
    joints = np.array([model.joint(name).id for name in spec.joint_names])
    bodies = model.jnt_bodyid[joints].astype(np.int64)
    link = np.full(model.nbody, -1)
    for joint, body in enumerate(bodies):
        link[model.body_weldid == body] = joint
    return Anatomy(
        model=model,
        joints=joints,
        play=np.array([model.joint(f"{name}/{PLAY}").id for name in spec.joint_names]),
        bodies=bodies,
        link=link,
        payload=model.body(PAYLOAD).id,
        cable=model.tendon(CABLE).id,
        anchor=model.site(ANCHOR).id,
        tool=model.site(spec.tool or BACK).id,
        level=model.body(LEVEL).id if "orientation" in spec.sensors else None,
        strongest=int(model.sensor(STRONGEST).adr[0]),
        base=_on_the_floor(model, spec, spec.base) if spec.base else None,
        sensed={kind: _places(model, kind, spec) for kind in spec.sensors if kind in SENSORS},
    )


def _on_the_floor(model: mujoco.MjModel, spec: RobotSpec, base: Base) -> FloatingBody:
    """Let the robot at home down to the floor, and tell the gantry that this is where to hold it."""
    data = mujoco.MjData(model)
    for name, q in zip(spec.joint_names, spec.joint_array("q_home"), strict=True):
        data.joint(name).qpos[0] = q
    mujoco.mj_kinematics(model, data)
    floor, fromto = int(_floors(model)[0]), np.zeros(6)
    solid = np.flatnonzero(((model.geom_contype | model.geom_conaffinity) != 0) & (model.geom_bodyid > 0))
    gaps = [mujoco.mj_geomDistance(model, data, floor, g, FAR_M, fromto) for g in solid]
    stands_m = float(model.qpos0[2] - min(gaps, default=0.0))
    gantry = model.equality(GANTRY).id
    at, to = model.jnt_qposadr[0], model.jnt_dofadr[0]
    # MuJoCo derives the gantry's place from here whenever it derives constants: see `drawn.embody`.
    model.qpos0[at + 2] = stands_m
    model.eq_data[gantry, :10] = *np.zeros(5), stands_m, *model.qpos0[at + 3 : at + 7]
    return FloatingBody(
        qpos=slice(at, at + 7),
        qvel=slice(to, to + 6),
        stands_m=stands_m,
        gantry=gantry,
        itself=int(model.sensor(SELF).adr[0]),
        allowed=np.array(
            [model.sensor(f"{SELF} {k}").adr[0] for k in range(len(base.may_touch))], dtype=np.int64
        ),
    )


def _places(model: mujoco.MjModel, kind: Kind, spec: RobotSpec) -> slice:
    sensors = [model.sensor(f"firstshift/{kind}/{site}") for site in spec.sensors[kind].sites]
    return slice(int(sensors[0].adr[0]), int(sensors[-1].adr[0] + sensors[-1].dim[0]))
