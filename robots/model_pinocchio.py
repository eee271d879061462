"""Pinocchio's model of a robot, and many robots in one model.

`Fleet` puts `BLOCK` copies of the robot side by side in one Pinocchio model, so one C++ call serves that many: 0.7 µs
of inverse dynamics per six-joint robot against 4 µs for a call each. More robots take their turns in the same model,
whose data stay in the cache. Wider blocks lose: building `pinocchio.Data` costs the fourth power of the joints in time
and the third in memory.
"""

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots.blocks import turns
from robots.clearance import Pairs, can_meet
from robots.errors import RobotError
from robots.spec import RobotSpec

Floats = NDArray[np.float64]

HINGES = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
"""What Pinocchio calls a hinge, by its axis."""


def load_pinocchio(spec: RobotSpec) -> tuple[pin.Model, pin.GeometryModel]:
    """Build model and collision geometry from model.xml.

    Raises:
        RobotError: Pinocchio cannot read the file or would leave a part of it out; a joint is no hinge; joints or tool
            are not those of robot.toml.
    """
    path = str(spec.model_path)
    try:
        model = pin.buildModelFromMJCF(path)
        geometry = pin.buildGeomFromMJCF(model, path, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as e:
        raise RobotError(f"{path}: Pinocchio cannot read it: {e!s:.300}") from e
    _check_parts(spec, model)
    for joint, low, high in zip(spec.joints, model.lowerPositionLimit, model.upperPositionLimit, strict=True):
        if not low <= joint.q_min < joint.q_max <= high:
            raise RobotError(
                f"{spec.folder / 'robot.toml'}: joints.{joint.name}: working range [{joint.q_min}, {joint.q_max}]"
                f" is not inside the mechanical [{low:.4f}, {high:.4f}] of model.xml"
            )
    return model, geometry


def _check_parts(spec: RobotSpec, model: pin.Model) -> None:
    path = str(spec.model_path)
    links = len(ElementTree.parse(path).findall("./worldbody/body"))
    if links != 1:
        raise RobotError(
            f"{path}: worldbody holds {links} bodies, expected 1: Pinocchio would leave the others out"
        )
    found = tuple(model.names[1:])
    if found != spec.joint_names:
        raise RobotError(f"{path}: joints are {found}; robot.toml lists {spec.joint_names}")
    for joint in model.joints[1:]:
        if joint.shortname() not in HINGES:
            raise RobotError(
                f"{path}: joint {model.names[joint.id]!r} is {joint.shortname()}, expected a hinge"
            )
    if not model.existFrame(spec.tool):
        raise RobotError(f"{path}: no site named {spec.tool!r}, which robot.toml calls the tool")


def torque_max(spec: RobotSpec) -> Floats:
    """(n,) N·m, each joint's `actuatorfrcrange` in model.xml.

    Raises:
        RobotError: a joint has none.
    """
    limit = np.array(load_pinocchio(spec)[0].upperEffortLimit)
    if not np.isfinite(limit).all():
        names = [name for name, value in zip(spec.joint_names, limit, strict=True) if not np.isfinite(value)]
        raise RobotError(f"{spec.model_path}: no actuatorfrcrange on joints {', '.join(names)}")
    return limit


def collision_pairs(model: pin.Model, geometry: pin.GeometryModel) -> Pairs:
    """Pairs of shapes on links that are neither the same nor parent and child."""
    parents = list(model.parents)
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    return [
        (a, b)
        for a in range(len(joints))
        for b in range(a + 1, len(joints))
        if joints[a] != joints[b] and parents[joints[a]] != joints[b] and parents[joints[b]] != joints[a]
    ]


class Fleet:
    """Kinematics and dynamics of B equal robots by the nominal model; arrays (B, ...), world frame.

    `place` computes what depends on joint angles only; the readings after it are of those angles and are overwritten
    by the next `place`.
    """

    def __init__(self, spec: RobotSpec, robots: int, *, collisions: bool = False) -> None:
        """Build the block.

        Args:
            spec: the robot.
            robots: B.
            collisions: whether `place` looks for them.

        Raises:
            RobotError: as `load_pinocchio`, or the home pose is too near a singularity.
        """
        model, geometry = load_pinocchio(spec)
        pairs = can_meet(spec, model, geometry, collision_pairs(model, geometry)) if collisions else []
        self.robots, self.n = robots, spec.n
        self._turns = turns(robots)
        self._block = _block(model, geometry, pairs, spec, self._turns[0].stop)
        self._tau = np.zeros((robots, spec.n))
        self._tool = np.zeros((robots, 3))
        self._jacobian = np.zeros((robots, 6, spec.n))
        self._looks, self._colliding = collisions, np.zeros(robots, dtype=bool)
        self._side = np.sign(_home(spec, model))

    def torque(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """(B, n) N·m by recursive Newton-Euler, rotor inertia included, friction not.

        Source: Featherstone, Rigid Body Dynamics Algorithms (2008), table 5.1.
        """
        b = self._block
        for rows in self._turns:
            tau = pin.rnea(b.model, b.data, q[rows].ravel(), qd[rows].ravel(), qdd[rows].ravel())
            self._tau[rows] = tau.reshape(-1, self.n)
        return self._tau

    def place(self, q: Floats) -> None:
        """Forward kinematics, tool Jacobian and collisions at joint angles (B, n) rad."""
        b = self._block
        for rows in self._turns:
            jacobian = pin.computeJointJacobians(b.model, b.data, q[rows].ravel())
            pin.updateFramePlacements(b.model, b.data)
            self._jacobian[rows] = jacobian.reshape(6, -1, self.n).transpose(1, 0, 2)
            self._see(rows)

    def _see(self, rows: slice) -> None:
        self._tool[rows] = self._block.tools
        if self._looks:
            self._colliding[rows] = self._block.colliding()

    def glance(self, q: Floats) -> None:
        """`place` for tool position and collisions only: nothing else may be read until the next `place`."""
        b = self._block
        for rows in self._turns:
            pin.forwardKinematics(b.model, b.data, q[rows].ravel())
            pin.updateFramePlacements(b.model, b.data)
            self._see(rows)

    @property
    def tool_position(self) -> Floats:
        """(B, 3) m, the tool in the world."""
        return self._tool

    def tool_velocity(self, qd: Floats, of: slice = slice(None)) -> Floats:
        """(R, 3) m/s, the tool in the world, for joint speeds (R, n) rad/s.

        Args:
            qd: joint speeds, a whole number of times as many rows as robots are chosen.
            of: the robots.
        """
        jacobian, crossing = self._jacobian[of], self._crossing(self._tool[of])
        twist = jacobian @ qd.reshape(-1, len(jacobian), self.n, 1)
        return np.asarray((twist[..., :3, :] + crossing @ twist[..., 3:, :]).reshape(-1, 3))

    def tool_pull(self, force: Floats) -> Floats:
        """(B, n) N·m, joint torques equal to a force (B, 3) N on the tool: Jᵀf."""
        wrench = np.concatenate((force[:, None], force[:, None] @ self._crossing(self._tool)), axis=2)
        return np.asarray((wrench @ self._jacobian)[:, 0])

    def manipulability(self) -> Floats:
        """(B,) √det(JᵀJ), or √det(JJᵀ) for more than six joints: 0 in a singularity.

        For six joints it is det J with the sign that makes the home pose's positive. That sign changes in a singularity
        only, so below 0 the robot is beyond one. It is the same for every point that moves with the tool.

        Source: Yoshikawa, Manipulability of Robotic Mechanisms (1985), eq. 4.
        """
        jacobian = self._jacobian
        if self.n != 6:
            jacobian = jacobian.copy()
            jacobian[:, :3] += self._crossing(self._tool) @ jacobian[:, 3:]
        return np.asarray(self._side * _measure(jacobian))

    def _crossing(self, tool: Floats) -> Floats:
        """(R, 3, 3), M of w × p = M w at tool positions p (R, 3).

        Pinocchio's Jacobian tells the velocity of the point at the world's origin: w × p moves it to the tool.
        """
        return (tool @ _CROSS).reshape(-1, 3, 3)

    @property
    def colliding(self) -> NDArray[np.bool_]:
        """(B,) whether any pair of shapes is nearer than the collision margin; q must be inside the working ranges.

        Raises:
            RuntimeError: this fleet was not built to look.
        """
        if not self._looks:
            raise RuntimeError("a fleet without collisions was asked for them")
        return self._colliding


def _measure(jacobian: Floats) -> Floats:
    """(R,) of tool Jacobians (R, 6, n): det J of six joints, Yoshikawa's measure of others."""
    n = jacobian.shape[2]
    if n == 6:
        return np.asarray(np.linalg.det(jacobian))
    turned = jacobian.transpose(0, 2, 1)
    gram = turned @ jacobian if n < 6 else jacobian @ turned
    return np.asarray(np.sqrt(np.maximum(np.linalg.det(gram), 0.0)))


def _home(spec: RobotSpec, model: pin.Model) -> float:
    """`_measure` of the home pose, which must not be singular."""
    frame, q = model.getFrameId(spec.tool), spec.joint_array("q_home")
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, frame, pin.LOCAL_WORLD_ALIGNED)
    found = float(_measure(jacobian[None])[0])
    if abs(found) < spec.margins.singularity:
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: joints: q_home: manipulability there is {abs(found):.2g}, expected at least"
            f" margins.singularity, {spec.margins.singularity}"
        )
    return found


_CROSS = np.array(
    [[0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0], [0, 1, 0, -1, 0, 0, 0, 0, 0]],
    dtype=np.float64,
)
"""p @ _CROSS, in rows of three, is the matrix M of w × p = M w."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Block:
    """Some robots side by side in one model; `tools` (copies, 3) is a live view into `data`."""

    model: pin.Model
    data: pin.Data
    geometry: pin.GeometryModel
    geometry_data: pin.GeometryData
    tools: Floats

    def colliding(self) -> NDArray[np.bool_] | bool:
        """(copies,) whether shapes are too near where `data` has the robots; one answer if none are."""
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.geometry_data)
        if not pin.computeCollisions(self.geometry, self.geometry_data, False):
            return False
        hits = [result.isCollision() for result in self.geometry_data.collisionResults]
        return np.asarray(np.reshape(hits, (len(self.tools), -1)).any(axis=1))


def _block(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs, spec: RobotSpec, copies: int
) -> _Block:
    wide, frames = _side_by_side(model, model.frames[model.getFrameId(spec.tool)], copies)
    shapes = _shapes_side_by_side(model, geometry, pairs, copies)
    data, shapes_data = wide.createData(), shapes.createData()
    for request in shapes_data.collisionRequests:
        request.security_margin = spec.margins.collision_m
    pin.framesForwardKinematics(wide, data, np.zeros(wide.nq))
    return _Block(
        model=wide, data=data, geometry=shapes, geometry_data=shapes_data, tools=_translations(data, frames)
    )


def _translations(data: pin.Data, frames: list[int]) -> Floats:
    """(F, 3) m, where consecutive frames are in the world: a live view, read in a seventh of the time of F views."""
    views = [data.oMf[frame].translation for frame in frames]
    address = [view.ctypes.data for view in views]
    stride = address[-1] - address[-2] if len(frames) > 1 else 0
    if address != [address[0] + stride * place for place in range(len(frames))]:
        raise RuntimeError("Pinocchio does not keep its frames side by side")
    return np.lib.stride_tricks.as_strided(views[0], (len(frames), 3), (stride, views[0].itemsize))


def _side_by_side(model: pin.Model, tool: pin.Frame, copies: int) -> tuple[pin.Model, list[int]]:
    """A model of several copies of the robot on the same spot, and the frame of each one's tool."""
    wide, frames = pin.Model(), []
    wide.gravity = model.gravity
    for copy in range(copies):
        ids = [0]
        for j in range(1, model.njoints):
            placement, name = model.jointPlacements[j], f"{copy}/{model.names[j]}"
            ids.append(wide.addJoint(ids[model.parents[j]], model.joints[j], placement, name))
            wide.appendBodyToJoint(ids[j], model.inertias[j], pin.SE3.Identity())
        frame = pin.Frame(f"{copy}/tool", ids[tool.parentJoint], 0, tool.placement, pin.FrameType.OP_FRAME)
        frames.append(wide.addFrame(frame, False))
    wide.armature = np.tile(model.armature, copies)
    return wide, frames


def _shapes_side_by_side(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs, copies: int
) -> pin.GeometryModel:
    """Collision shapes of the copies; pairs only within a copy, ordered by copy."""
    wide, joints = pin.GeometryModel(), model.njoints - 1
    for copy in range(copies):
        for shape in geometry.geometryObjects:
            parent = shape.parentJoint and shape.parentJoint + copy * joints
            wide.addGeometryObject(
                pin.GeometryObject(f"{copy}/{shape.name}", parent, shape.placement, shape.geometry)
            )
        for a, b in pairs:
            offset = copy * geometry.ngeoms
            wide.addCollisionPair(pin.CollisionPair(a + offset, b + offset))
    return wide
