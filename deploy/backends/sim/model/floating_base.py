"""Ground of a robot with a floating base: floor, gantry, and count of self-contacts."""

from dataclasses import dataclass

import mujoco
import numpy as np

from deploy.backends.sim.model.allowed_contacts import add_contact_sensor
from deploy.backends.sim.model.attachments import root_body
from robots.arrays import Ints
from robots.models.files import OWN
from robots.spec import RobotSpec

FLOOR, GANTRY, SELF_CONTACTS = f"{OWN}floor", f"{OWN}gantry", f"{OWN}self-contacts"
FAR_M = 10.0
"""Greatest distance to the floor at which model.xml may hold a robot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FloatingBase:
    """Places of a floating base in the state, and of its contacts in `sensordata`.

    Attributes:
        qpos, qvel: its seven and six numbers in the state.
        stands_m: m, its height when the lowest part of the robot at home touches the floor.
        gantry: id of the equality that holds it until the drives are on.
        self_contacts: place of the number of the robot's contacts with itself.
    """

    qpos: slice
    qvel: slice
    stands_m: float
    gantry: int
    self_contacts: int


def add_ground(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, spec: RobotSpec) -> None:
    """Add a floor where model.xml has none, a gantry that holds the base, and a sensor that counts self-contacts.

    A robot that is mounted needs none of it.
    """
    if spec.base is None:
        return
    if not _floors(nominal).size:
        mjcf.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    gantry = mjcf.add_equality(name=GANTRY, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    root = root_body(nominal)
    gantry.name1, gantry.name2 = "world", root
    add_contact_sensor(mjcf, SELF_CONTACTS, (root, root), mujoco.mjtObj.mjOBJ_XBODY)


def _floors(model: mujoco.MjModel) -> Ints:
    """Return the ids of planes that are fixed to the world."""
    return np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0))


def find_floating_base(model: mujoco.MjModel, spec: RobotSpec) -> FloatingBase | None:
    """Lower the robot at home to the floor, and let the gantry hold it there; None for a robot that is mounted."""
    if spec.base is None:
        return None
    data = mujoco.MjData(model)
    for name, q in zip(spec.joint_names, spec.joint_array("q_home"), strict=True):
        data.joint(name).qpos[0] = q
    mujoco.mj_kinematics(model, data)
    floor, fromto = int(_floors(model)[0]), np.zeros(6)
    solid = np.flatnonzero(((model.geom_contype | model.geom_conaffinity) != 0) & (model.geom_bodyid > 0))
    gaps = [mujoco.mj_geomDistance(model, data, floor, g, FAR_M, fromto) for g in solid]
    stands_m = float(model.qpos0[2] - min(gaps, default=0.0))
    gantry = model.equality(GANTRY).id
    qpos, qvel = model.jnt_qposadr[0], model.jnt_dofadr[0]
    # MuJoCo derives the gantry's place from `qpos0` whenever it derives constants, as `write_draw` does.
    model.qpos0[qpos + 2] = stands_m
    model.eq_data[gantry, :10] = *np.zeros(5), stands_m, *model.qpos0[qpos + 3 : qpos + 7]
    return FloatingBase(
        qpos=slice(qpos, qpos + 7),
        qvel=slice(qvel, qvel + 6),
        stands_m=stands_m,
        gantry=gantry,
        self_contacts=int(model.sensor(SELF_CONTACTS).adr[0]),
    )
