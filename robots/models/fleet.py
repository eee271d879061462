"""Pinocchio's model of a robot, and many robots in one model.

`Fleet` puts `BLOCK` copies of the robot side by side in one Pinocchio model, so one C++ call serves that many: 0.7 µs
of inverse dynamics per six-joint robot against 4 µs for a call each. More robots take their turns in the same model,
whose data stay in the cache. Wider blocks lose: building `pinocchio.Data` costs the fourth power of the joints in time
and the third in memory.
"""

import copy
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots.arrays import Floats
from robots.errors import RobotError
from robots.models.blocks import lined_up, turns
from robots.models.clearance import can_meet
from robots.models.collisions import Collisions, check_home, collision_pairs, nearest
from robots.models.inertial import check_contacts, imu_in_base
from robots.models.pinocchio_model import foot_frames, read_pinocchio, tool_frame
from robots.spec import RobotSpec

HINGES = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
"""What Pinocchio calls a hinge, by its axis."""


def load_pinocchio(spec: RobotSpec) -> tuple[pin.Model, pin.GeometryModel]:
    """Build model and collision geometry; of a robot with a base, as seen from there.

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
        imu_in_base(spec, model)
        check_contacts(spec, spec.base, model)


def torque_max(spec: RobotSpec) -> Floats:
    """(n,) N·m, each joint's `actuatorfrcrange` in the model, or what its drive says where the model has none.

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
        self.n, self._looks = spec.n, collisions
        self._blocks = _Blocks(spec, collisions=collisions)
        self._side = np.sign(_home(spec, self._blocks.model)) if spec.tool else 0.0
        self._resize(robots)

    def of(self, robots: int) -> "Fleet":
        """A fleet of another size. Where their blocks are as wide, both work in the same one, which stays in the cache.

        Nothing that can be read is shared, but two such fleets must not be used from two threads.
        """
        other = copy.copy(self)
        other._resize(robots)
        return other

    def _resize(self, robots: int) -> None:
        self.robots, self._turns = robots, turns(robots)
        self._block = self._blocks.of(self._turns[0].stop)
        self._tau, self._points = (
            np.zeros((robots, self.n)),
            np.zeros((robots, len(self._blocks.followed), 3)),
        )
        self._tool, self._feet = self._points[:, 0:1].reshape(robots, -1), self._points[:, self._blocks.feet]
        self._jacobian, self._colliding = np.zeros((robots, 6, self.n)), np.zeros(robots, dtype=bool)

    def nearest(self, poses: Floats) -> tuple[float, str, str]:
        """M between the two shapes that come nearest to each other in any of some poses (P, n) rad, and their names.

        Infinitely far, and nameless, where nothing can meet; a pose that is no numbers is left out.
        """
        return self._blocks.nearest(poses)

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
        b = self._block
        self._points[rows] = b.points
        if b.collisions:
            self._colliding[rows] = b.collisions.look(b.model, b.data)

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

    @property
    def feet_position(self) -> Floats:
        """(B, F, 3) m, the feet as seen from the IMU."""
        return self._feet - self._blocks.imu

    def feet_velocity(self, qd: Floats) -> Floats:
        """(B, F, 3) m/s, of the feet as seen from the IMU, for joint speeds (B, n) rad/s."""
        of_legs = (self._blocks.carried_by * qd[:, None]).swapaxes(1, 2)
        twist = (self._jacobian @ of_legs).swapaxes(1, 2)
        return np.asarray(twist[..., :3] + np.cross(twist[..., 3:], self._feet))

    def tool_velocity(self, qd: Floats, of: slice = slice(None)) -> Floats:
        """(R, 3) m/s, the tool in the world, for joint speeds (R, n) rad/s.

        Args:
            qd: joint speeds, a whole number of times as many rows as robots are chosen.
            of: the robots.
        """
        jacobian, crossing = self._jacobian[of], self._crossing(self._tool[of])
        twist = np.matvec(jacobian, qd.reshape(-1, len(jacobian), self.n))
        return np.asarray((twist[..., :3] + np.matvec(crossing, twist[..., 3:])).reshape(-1, 3))

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
    (frame,), q = tool_frame(spec, model), spec.joint_array("q_home")
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, frame, pin.LOCAL_WORLD_ALIGNED)
    found = float(_measure(jacobian[None])[0])
    if spec.margins.singularity is not None and abs(found) < spec.margins.singularity:
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


class _Blocks:
    """Blocks of one robot by number of copies, each built when it is first asked for."""

    def __init__(self, spec: RobotSpec, *, collisions: bool) -> None:
        self.model, self._geometry = load_pinocchio(spec)
        self._margin = spec.margins.collision_m
        tool, feet = tool_frame(spec, self.model), foot_frames(spec, self.model)
        self.followed = [self.model.frames[frame] for frame in (*tool, *feet)]
        self.feet = slice(len(tool), None)
        self.imu = imu_in_base(spec, self.model) if spec.base else np.zeros(3)
        supports = [list(self.model.supports[frame.parentJoint]) for frame in self.followed[self.feet]]
        self.carried_by = np.array(
            [[j in some for j in range(1, self.model.njoints)] for some in supports], float
        )
        near = (*spec.neighbours, *(spec.base.may_touch if spec.base else ()))
        pairs = collision_pairs(self.model, self._geometry, near) if collisions and self._margin else []
        check_home(spec, self.model, self._geometry, pairs)
        self._pairs = can_meet(spec, self.model, self._geometry, pairs)
        self._built: dict[int, _Block] = {}

    def nearest(self, poses: Floats) -> tuple[float, str, str]:
        """As `Fleet.nearest`."""
        return nearest(self.model, self._geometry, self._pairs, poses)

    def of(self, copies: int) -> "_Block":
        """The block of so many."""
        if copies not in self._built:
            wide, frames = _side_by_side(self.model, self.followed, copies)
            data = wide.createData()
            pin.framesForwardKinematics(wide, data, np.zeros(wide.nq))
            self._built[copies] = _Block(
                model=wide,
                data=data,
                points=lined_up([data.oMf[f].translation for f in frames]).reshape(copies, -1, 3)
                if frames
                else np.zeros((copies, 0, 3)),
                collisions=self._collisions(copies),
            )
        return self._built[copies]

    def _collisions(self, copies: int) -> Collisions | None:
        if not self._pairs or self._margin is None:
            return None
        return Collisions(self.model, self._geometry, self._pairs, copies, self._margin)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Block:
    """Some robots side by side in one model; `points` (copies, F, 3) of tool or feet is a live view into `data`.

    Nothing can collide, or nobody looks, where `collisions` is None.
    """

    model: pin.Model
    data: pin.Data
    points: Floats
    collisions: Collisions | None


def _side_by_side(model: pin.Model, followed: list[pin.Frame], copies: int) -> tuple[pin.Model, list[int]]:
    """A model of several copies of the robot on the same spot, and the frames of what is followed of each."""
    wide, frames = pin.Model(), []
    wide.gravity = model.gravity
    for number in range(copies):
        ids = [0]
        for j in range(1, model.njoints):
            placement, name = model.jointPlacements[j], f"{number}/{model.names[j]}"
            ids.append(wide.addJoint(ids[model.parents[j]], model.joints[j], placement, name))
            wide.appendBodyToJoint(ids[j], model.inertias[j], pin.SE3.Identity())
        for frame in followed:
            name, joint = f"{number}/{frame.name}", ids[frame.parentJoint]
            same = pin.Frame(name, joint, 0, frame.placement, pin.FrameType.OP_FRAME)
            frames.append(wide.addFrame(same, False))
    wide.armature = np.tile(model.armature, copies)
    return wide, frames
