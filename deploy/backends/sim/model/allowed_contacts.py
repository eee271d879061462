"""Allowed contacts of the plant: sensors of their number and force, and a goal that can be touched."""

from dataclasses import dataclass

import mujoco
import numpy as np

from robots.arrays import Ints
from robots.contacts import GOAL, WORLD
from robots.errors import RobotError
from robots.models.files import OWN
from robots.spec import RobotSpec

CONTACT_FORCE, TOUCHED = f"{OWN}strongest contact", f"{OWN}goal contacts"
SLOTS = 8
"""Contacts of one pair whose forces are known; more of them count as not allowed."""
GOAL_RADIUS_M = 0.03
PARKED = (0.0, 0.0, 1000.0)
"""m, place of a goal that is not there."""
ALL_BITS = 2**31 - 1
_FOUND, _FORCE = (
    1 << int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{name}")) for name in ("FOUND", "FORCE")
)
_ANY, _STRONGEST = 0, 2
_BODY = mujoco.mjtObj.mjOBJ_BODY


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalSphere:
    """Goal as a sphere: id of its geom, number of its mocap body, place of the number of its contacts."""

    geom: int
    mocap: int
    found: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactPlaces:
    """Places in `sensordata`.

    Attributes:
        strongest: (K, 3) forces of the strongest contacts, strongest first; the first number of each is the normal one.
        own: numbers of contacts of each allowed pair without the goal; of a robot with a base, whose contacts with
            the world do not count, without the world as well. goal: of each pair with the goal.
        limited: (P, SLOTS, 3) forces of the allowed pairs that have a limit.
        sphere: of a robot that may touch the goal, or None.
    """

    strongest: Ints
    own: Ints
    goal: Ints
    limited: Ints
    sphere: GoalSphere | None


def add_contacts(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, spec: RobotSpec) -> None:
    """Add the sensors, and the goal's sphere where the robot may touch it.

    Raises:
        RobotError: `may_touch` names a body that is not in model.xml, or the goal, and a part there is called so, too.
    """
    bodies = [nominal.body(body).name for body in range(1, nominal.nbody)]
    if spec.touches_goal:
        if mjcf.body(GOAL) or mjcf.geom(GOAL):
            raise RobotError(
                f"{spec.model_path}: found a body or geom {GOAL!r}, expected none: the goal is called so"
            )
        goal = mjcf.worldbody.add_body(name=GOAL, mocap=True, pos=PARKED)
        size, bits = [GOAL_RADIUS_M, 0.0, 0.0], {"contype": ALL_BITS, "conaffinity": ALL_BITS}
        goal.add_geom(name=GOAL, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size, condim=3, **bits)
        add_contact_sensor(mjcf, TOUCHED, (GOAL,), _BODY, _FOUND)
    for number, pair in enumerate(spec.may_touch):
        for body in pair.bodies:
            spec.check_known("may_touch", body, "a body", [GOAL, WORLD, *bodies])
        add_contact_sensor(mjcf, _name(number), pair.bodies, _BODY, _FOUND)
        if pair.force_n is not None:
            add_contact_sensor(mjcf, _force_name(number), pair.bodies, _BODY, _FORCE, _STRONGEST, SLOTS)
    slots = 1 + SLOTS * len(_limited(spec))
    add_contact_sensor(mjcf, CONTACT_FORCE, (), mujoco.mjtObj.mjOBJ_UNKNOWN, _FORCE, _STRONGEST, slots)


def add_contact_sensor(
    mjcf: mujoco.MjSpec,
    name: str,
    between: tuple[str, ...],
    kind: mujoco.mjtObj,
    field: int = _FOUND,
    reduce: int = _ANY,
    slots: int = 1,
) -> None:
    """Add a sensor of contacts between two objects, of one with anything, or of all; by default of their number.

    The forces of a contact are in its own frame, whose first axis is the normal.
    """
    sensor = mjcf.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT)
    if between:
        sensor.objtype, sensor.objname = kind, between[0]
    if len(between) > 1:
        sensor.reftype, sensor.refname = kind, between[1]
    sensor.intprm[:3] = field, reduce, slots


def _name(number: int) -> str:
    return f"{OWN}allowed contacts {number}"


def _force_name(number: int) -> str:
    return f"{_name(number)} force"


def _limited(spec: RobotSpec) -> list[int]:
    """Return the numbers of the pairs that have a limit."""
    return [number for number, pair in enumerate(spec.may_touch) if pair.force_n is not None]


def find_contacts(model: mujoco.MjModel, spec: RobotSpec) -> ContactPlaces:
    """Find the places of the sensors."""
    sphere = None
    if spec.touches_goal:
        mocap = int(model.body_mocapid[model.body(GOAL).id])
        sphere = GoalSphere(geom=model.geom(GOAL).id, mocap=mocap, found=int(model.sensor(TOUCHED).adr[0]))

    def counts(pairs: list[int]) -> Ints:
        return np.array([model.sensor(_name(k)).adr[0] for k in pairs], dtype=np.int64)

    return ContactPlaces(
        strongest=_forces(model, CONTACT_FORCE),
        own=counts(_own(spec)),
        goal=counts([k for k, pair in enumerate(spec.may_touch) if GOAL in pair.bodies]),
        limited=np.array([_forces(model, _force_name(k)) for k in _limited(spec)], dtype=np.int64),
        sphere=sphere,
    )


def _own(spec: RobotSpec) -> list[int]:
    """Return the numbers of the pairs whose contacts count as the robot's own."""
    others = {GOAL, WORLD} if spec.base else {GOAL}
    return [number for number, pair in enumerate(spec.may_touch) if others.isdisjoint(pair.bodies)]


def _forces(model: mujoco.MjModel, name: str) -> Ints:
    sensor = model.sensor(name)
    return np.arange(sensor.adr[0], sensor.adr[0] + sensor.dim[0]).reshape(-1, 3)
