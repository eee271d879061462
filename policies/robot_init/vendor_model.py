"""What a vendor's model knows of its robot: MuJoCo's reading of it, in words of robot.toml."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from policies.robot_init.capsules import Shape, shape_of
from robots.errors import RobotError
from robots.models.files import is_urdf, read_xml
from robots.models.mujoco_model import compile_model, open_model

_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
TOOLS = ("tool", "tcp", "ee", "eef", "end_effector", "grip_site", "grasp_site", "pinch", "attachment_site")
"""What a tool's site is mostly called."""
JOINTS_MAX, BODIES_MAX, SHAPES_MAX = 100, 500, 500
"""More than robots have: what is made of them takes the square of their number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointFacts:
    """One joint; None for what the model does not say.

    Attributes:
        body: that it moves.
        slides: whether it is no hinge.
        low, high, home: rad. qd_max: rad/s.
        torque_range: N·m, of the joint. torque_max: N·m, of its actuator, where the joint says nothing.
        kp, kd: N·m/rad and N·m·s/rad at the joint. gear: of an actuator that has one.
        driven: whether an actuator moves it.
        armature: kg·m² of its rotor, behind the gear; 0 where the model has none.
    """

    name: str
    body: str
    slides: bool
    low: float | None
    high: float | None
    home: float | None
    qd_max: float | None
    torque_range: float | None
    torque_max: float | None
    kp: float | None
    kd: float | None
    gear: float | None
    driven: bool
    armature: float

    @property
    def span(self) -> tuple[float, float]:
        """Where it can be; one turn, where the model does not say."""
        return (-np.pi, np.pi) if self.low is None or self.high is None else (self.low, self.high)


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """One model.

    Attributes:
        joints: hinges and slides in the model's order.
        sites: names. ends: bodies that carry no other. bodies: names.
        shapes: of bodies that can touch something; plain: whether all of them are capsules.
        neighbours: pairs of bodies that the model excludes.
        floats: whether a joint is free. drives: whether it has dcmotors.
        centre: m, of the first joint. reach: m, from there to the farthest body, stretched.
    """

    joints: tuple[JointFacts, ...]
    sites: tuple[str, ...]
    ends: tuple[str, ...]
    bodies: tuple[str, ...]
    shapes: tuple[Shape, ...]
    plain: bool
    neighbours: tuple[tuple[str, str], ...]
    floats: bool
    drives: bool
    centre: tuple[float, float, float]
    reach: float

    @property
    def locked(self) -> tuple[str, ...]:
        """Joints that look as if no policy drove them: slides, and what no actuator moves where others are moved."""
        some = any(joint.driven for joint in self.joints)
        return tuple(joint.name for joint in self.joints if joint.slides or (some and not joint.driven))

    @property
    def tool(self) -> str | None:
        """A site that is called like one, or the only end."""
        named = [name for tool in TOOLS for name in self.sites if name == tool]
        return named[0] if named else self.ends[0] if len(self.ends) == 1 else None


def read_facts(path: Path, folder: Path) -> Facts:
    """Read a model.

    Raises:
        RobotError: MuJoCo cannot read it, it has more parts than robots have, or a joint or its body has no name.
    """
    mjcf = open_model(path, folder)
    neighbours = tuple((each.bodyname1, each.bodyname2) for each in mjcf.excludes)
    model = compile_model(mjcf, path)
    touching = [i for i in range(model.ngeom) if model.geom_bodyid[i] and _touches(model, i)]
    _check_sizes(model, touching, path)
    _check_names(model, path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    speeds = _speeds(path)
    kinds = model.jnt_type.tolist()
    moving = [i for i, kind in enumerate(kinds) if kind in (_HINGE, _SLIDE)]
    joints = tuple(_joint(model, i, path, speeds) for i in moving)
    carriers = set(model.body_parentid[1:])
    bodies = tuple(model.body(i).name for i in range(1, model.nbody))
    return Facts(
        joints=joints,
        sites=tuple(name for i in range(model.nsite) if (name := model.site(i).name)),
        ends=tuple(model.body(i).name for i in range(1, model.nbody) if i not in carriers),
        bodies=bodies,
        shapes=tuple(shape for i in touching if (shape := shape_of(model, i))),
        plain=all(model.geom_type[i] == mujoco.mjtGeom.mjGEOM_CAPSULE for i in touching),
        neighbours=tuple(pair for pair in neighbours if set(pair) <= set(bodies)),
        floats=mujoco.mjtJoint.mjJNT_FREE in kinds,
        drives=bool((model.actuator_dyntype == mujoco.mjtDyn.mjDYN_DCMOTOR).any()),
        centre=tuple(data.xanchor[moving[0]].round(4).tolist()) if moving else (0.0, 0.0, 0.0),
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


def _check_names(model: mujoco.MjModel, path: Path) -> None:
    """They become text of robot.toml, some of it in comments, which end with their line."""
    named = {"joint": model.njnt, "body": model.nbody, "site": model.nsite}
    for kind, count in named.items():
        for name in (getattr(model, kind)(i).name for i in range(count)):
            if not name.isprintable():
                raise RobotError(f"{path}: {kind}: found name {name!r:.80}, expected printable characters")


def _joint(model: mujoco.MjModel, i: int, path: Path, speeds: dict[str, float]) -> JointFacts:
    joint, body = model.joint(i), model.body(model.jnt_bodyid[i])
    if not joint.name or not body.name:
        raise RobotError(
            f"{path}: joint {i} ({joint.name!r}) of body {body.name!r}: expected a name for both"
        )
    limited, bounded = bool(model.jnt_limited[i]), bool(model.jnt_actfrclimited[i])
    acting = _acting(model, i)
    own = acting or _Acting(None, None, None, None)
    return JointFacts(
        name=joint.name,
        body=body.name,
        slides=bool(model.jnt_type[i] == _SLIDE),
        low=float(model.jnt_range[i, 0]) if limited else None,
        high=float(model.jnt_range[i, 1]) if limited else None,
        home=_home(model, i),
        qd_max=speeds.get(joint.name),
        torque_range=float(model.jnt_actfrcrange[i, 1]) if bounded else None,
        torque_max=None if bounded else own.torque_max,
        kp=own.kp,
        kd=own.kd,
        gear=own.gear,
        driven=acting is not None,
        armature=float(model.dof_armature[model.jnt_dofadr[i]]),
    )


@dataclass(frozen=True, slots=True)
class _Acting:
    """What the model's own actuator of a joint says, on the joint's side."""

    torque_max: float | None
    kp: float | None
    kd: float | None
    gear: float | None


def _acting(model: mujoco.MjModel, joint: int) -> _Acting | None:
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    found = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint))
    if not len(found):
        return None
    actuator, kp, kd = found[0], None, None
    gear = float(model.actuator_gear[actuator, 0])
    if model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE:
        # 0 is none: a velocity actuator has no stiffness. A force of kp (u - l) has a bias of -kp.
        kp, kd = (round(float(gain), 6) or None for gain in -model.actuator_biasprm[actuator, 1:3] * gear**2)
    return _Acting(_torque(model, actuator, gear), kp, kd, gear if abs(gear) > 1.0 else None)


def _torque(model: mujoco.MjModel, actuator: int, gear: float) -> float | None:
    """N·m: the range of its force, or of a plain motor's control."""
    if model.actuator_forcelimited[actuator]:
        return float(model.actuator_forcerange[actuator, 1] * abs(gear))
    plain = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    if plain and model.actuator_ctrllimited[actuator]:
        gain = float(model.actuator_gainprm[actuator, 0])
        return float(model.actuator_ctrlrange[actuator, 1]) * gain * abs(gear)
    return None


def _home(model: mujoco.MjModel, joint: int) -> float | None:
    """rad, of the keyframe called home, or of the first."""
    names = [model.key(i).name for i in range(model.nkey)]
    if not names:
        return None
    key = names.index("home") if "home" in names else 0
    return round(float(model.key_qpos[key, model.jnt_qposadr[joint]]), 6)


def _speeds(path: Path) -> dict[str, float]:
    """rad/s by joint, of URDF: MuJoCo leaves them out."""
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
        raise RobotError(
            f"{path}: joint {joint!r:.80}: velocity: found {found!r:.80}, expected a number"
        ) from e


def _touches(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def _reach(model: mujoco.MjModel, moving: list[int]) -> float:
    """m, the longest way from the first joint along bodies."""
    if not moving:
        return 0.0
    far, first = np.zeros(model.nbody), model.jnt_bodyid[moving[0]]
    for body in range(first + 1, model.nbody):
        if first in set(_ancestors(model, body)):
            far[body] = far[model.body_parentid[body]] + np.linalg.norm(model.body_pos[body])
    return round(float(far.max()), 3)


def _ancestors(model: mujoco.MjModel, body: int) -> Iterator[int]:
    while body:
        body = int(model.body_parentid[body])
        yield body
