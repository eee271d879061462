"""Properties of a robot read from a vendor's MJCF or URDF with MuJoCo, in the terms of robot.toml."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from policies.robot_init.capsules import Capsule, capsule_of
from robots.errors import RobotError
from robots.models.files import is_urdf, read_xml
from robots.models.mujoco_model import compile_model, open_model

_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
TOOLS = ("tool", "tcp", "ee", "eef", "end_effector", "grip_site", "grasp_site", "pinch", "attachment_site")
"""Common names of a tool's site."""
JOINTS_MAX, BODIES_MAX, SHAPES_MAX = 100, 500, 500
"""Limits of the model size; the effort grows with the square."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Actuator:
    """Properties of a joint's actuator at the joint side; None for values that the model does not have.

    Attributes:
        torque_max: N·m. kp, kd: N·m/rad and N·m·s/rad. gear: motor turns per joint turn.
    """

    torque_max: float | None = None
    kp: float | None = None
    kd: float | None = None
    gear: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class VendorJoint:
    """A joint; None for values that the model does not have.

    Attributes:
        body: moved by the joint.
        slides: True for a prismatic joint.
        low, high, home: rad. qd_max: rad/s. torque_range: N·m.
        actuator: None if it is not driven.
        armature: kg·m² of the rotor at the joint side; 0 if the model has none.
    """

    name: str
    body: str
    slides: bool
    low: float | None
    high: float | None
    home: float | None
    qd_max: float | None
    torque_range: float | None
    actuator: Actuator | None
    armature: float

    @property
    def span(self) -> tuple[float, float]:
        """Range of the joint; one turn if the model has none."""
        return (-np.pi, np.pi) if self.low is None or self.high is None else (self.low, self.high)


@dataclass(frozen=True, slots=True, kw_only=True)
class VendorModel:
    """A vendor's model.

    Attributes:
        joints: hinges and slides in the model's order.
        sites: names. ends: names of bodies without children. bodies: names.
        shapes: capsules of colliding shapes. plain: True if all of these shapes are capsules.
        neighbours: pairs of bodies excluded from contact by the model.
        floating_base: True with a free joint. drives: True with dcmotor actuators.
        centre: m, position of the first joint. reach: m, from there to the farthest body, stretched.
    """

    joints: tuple[VendorJoint, ...]
    sites: tuple[str, ...]
    ends: tuple[str, ...]
    bodies: tuple[str, ...]
    shapes: tuple[Capsule, ...]
    plain: bool
    neighbours: tuple[tuple[str, str], ...]
    floating_base: bool
    drives: bool
    centre: tuple[float, ...]
    reach: float

    @property
    def locked(self) -> tuple[str, ...]:
        """Joints that are probably not driven by a policy: slides, and joints without actuator if others have one."""
        any_driven = any(joint.actuator for joint in self.joints)
        return tuple(
            joint.name for joint in self.joints if joint.slides or (any_driven and not joint.actuator)
        )

    @property
    def driven(self) -> tuple[VendorJoint, ...]:
        """Joints that are not locked."""
        return tuple(joint for joint in self.joints if joint.name not in self.locked)

    @property
    def tool(self) -> str | None:
        """Name of a site in `TOOLS`, or of the only end body, or None."""
        named = [name for tool in TOOLS for name in self.sites if name == tool]
        return named[0] if named else self.ends[0] if len(self.ends) == 1 else None


def read_vendor_model(path: Path, folder: Path) -> VendorModel:
    """Read a model.

    Raises:
        RobotError: MuJoCo cannot read it, it is too large, or a joint or its body has no name.
    """
    mjcf = open_model(path, folder)
    neighbours = tuple((each.bodyname1, each.bodyname2) for each in mjcf.excludes)
    model = compile_model(mjcf, path)
    touching = np.flatnonzero(
        (model.geom_contype | model.geom_conaffinity) & (model.geom_bodyid > 0)
    ).tolist()
    _check_sizes(model, touching, path)
    kinds, speeds = model.jnt_type.tolist(), _speeds(path)
    moving = [i for i, kind in enumerate(kinds) if kind in (_HINGE, _SLIDE)]
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    carriers = {model.body(i).name for i in model.body_parentid[1:]}
    return VendorModel(
        joints=tuple(_joint(model, i, path, speeds) for i in moving),
        sites=tuple(name for i in range(model.nsite) if (name := model.site(i).name)),
        ends=tuple(body for body in bodies if body not in carriers),
        bodies=tuple(bodies),
        shapes=tuple(shape for i in touching if (shape := capsule_of(model, i))),
        plain=all(model.geom_type[i] == mujoco.mjtGeom.mjGEOM_CAPSULE for i in touching),
        neighbours=tuple(pair for pair in neighbours if set(pair) <= set(bodies)),
        floating_base=mujoco.mjtJoint.mjJNT_FREE in kinds,
        drives=bool((model.actuator_dyntype == mujoco.mjtDyn.mjDYN_DCMOTOR).any()),
        centre=_centre(model, moving),
        reach=_reach(model, moving),
    )


def _check_sizes(model: mujoco.MjModel, touching: list[int], path: Path) -> None:
    for what, found, most in (
        ("joints", model.njnt, JOINTS_MAX),
        ("bodies", model.nbody - 1, BODIES_MAX),
        ("shapes that touch", len(touching), SHAPES_MAX),
    ):
        if found > most:
            raise RobotError(f"{path}: found {found} {what}, expected at most {most}")


def _joint(model: mujoco.MjModel, i: int, path: Path, speeds: dict[str, float]) -> VendorJoint:
    joint, body = model.joint(i), model.body(model.jnt_bodyid[i])
    if not joint.name or not body.name:
        raise RobotError(
            f"{path}: joint {i} ({joint.name!r}) of body {body.name!r}: expected a name for both"
        )
    low, high = model.jnt_range[i].tolist() if model.jnt_limited[i] else (None, None)
    return VendorJoint(
        name=joint.name,
        body=body.name,
        slides=bool(model.jnt_type[i] == _SLIDE),
        low=low,
        high=high,
        home=_home(model, i),
        qd_max=speeds.get(joint.name),
        torque_range=float(model.jnt_actfrcrange[i, 1]) if model.jnt_actfrclimited[i] else None,
        actuator=_actuator(model, i),
        armature=float(model.dof_armature[model.jnt_dofadr[i]]),
    )


def _actuator(model: mujoco.MjModel, joint: int) -> Actuator | None:
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    found = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint))
    if not len(found):
        return None
    actuator, kp, kd = found[0], None, None
    gear = float(model.actuator_gear[actuator, 0])
    if model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE:
        # 0 means none: a velocity actuator has no stiffness. The bias of a force kp (u - l) is -kp.
        kp, kd = (round(float(gain), 6) or None for gain in -model.actuator_biasprm[actuator, 1:3] * gear**2)
    torque_max = None if model.jnt_actfrclimited[joint] else _torque(model, actuator, gear)
    return Actuator(torque_max=torque_max, kp=kp, kd=kd, gear=gear if abs(gear) > 1.0 else None)


def _torque(model: mujoco.MjModel, actuator: int, gear: float) -> float | None:
    """Return N·m from the force range, or from a plain motor's control range."""
    if model.actuator_forcelimited[actuator]:
        return float(model.actuator_forcerange[actuator, 1] * abs(gear))
    plain = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    if plain and model.actuator_ctrllimited[actuator]:
        gain = float(model.actuator_gainprm[actuator, 0])
        return float(model.actuator_ctrlrange[actuator, 1]) * gain * abs(gear)
    return None


def _home(model: mujoco.MjModel, joint: int) -> float | None:
    """Return rad of the keyframe named home, or of the first."""
    names = [model.key(i).name for i in range(model.nkey)]
    if not names:
        return None
    key = names.index("home") if "home" in names else 0
    return round(float(model.key_qpos[key, model.jnt_qposadr[joint]]), 6)


def _speeds(path: Path) -> dict[str, float]:
    """Return velocity limits in rad/s by joint from URDF, which MuJoCo ignores."""
    if not is_urdf(path):
        return {}
    joints = read_xml(path).findall("joint")
    limits = {joint.get("name", ""): joint.find("limit") for joint in joints}
    return {name: _speed(name, limit, path) for name, limit in limits.items() if limit is not None}


def _speed(joint: str, limit: Element, path: Path) -> float:
    found = limit.get("velocity", "0")
    try:
        return float(found)
    except ValueError as e:
        where = f"{path}: joint {joint!r:.80}: velocity"
        raise RobotError(f"{where}: found {found!r:.80}, expected a number") from e


def _centre(model: mujoco.MjModel, moving: list[int]) -> tuple[float, ...]:
    """Return the position of the first joint, m; the origin without joints."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return tuple(data.xanchor[moving[0]].round(4).tolist()) if moving else (0.0, 0.0, 0.0)


def _reach(model: mujoco.MjModel, moving: list[int]) -> float:
    """Return m, the longest path from the first joint along bodies."""
    if not moving:
        return 0.0
    distance, first = np.zeros(model.nbody), model.jnt_bodyid[moving[0]]
    for body in range(first + 1, model.nbody):
        if first in set(_ancestors(model, body)):
            distance[body] = distance[model.body_parentid[body]] + np.linalg.norm(model.body_pos[body])
    return round(float(distance.max()), 3)


def _ancestors(model: mujoco.MjModel, body: int) -> Iterator[int]:
    while body:
        body = int(model.body_parentid[body])
        yield body
