"""Copies of a robot side by side in one Pinocchio model, so that one call serves all of them.

Wider blocks than `BLOCK` lose: building `pinocchio.Data` costs the fourth power of the joints in time and the third in
memory.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from robots.arrays import Bools, Floats, Ints
from robots.errors import RobotError
from robots.models.blocks import strided_view
from robots.models.collision_pruning import pairs_to_check
from robots.models.collisions import Collisions, check_home, collision_pairs, gaps, nearest_shapes
from robots.models.kinematics import Frames
from robots.models.nominal_model import imu_in_base, load_pinocchio
from robots.models.pinocchio_model import foot_frames, tool_frame
from robots.models.tool_jacobian import find_manipulability
from robots.spec import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Some robots side by side in one model.

    Attributes:
        model, data: of all copies.
        points: (copies, F, 3) m, tool, if any, and feet: a live view into `data`.
        collisions: None where nothing can collide, or is not to be checked.
    """

    model: pin.Model
    data: pin.Data
    points: Floats
    collisions: Collisions | None


class Blocks:
    """Blocks of one robot by number of copies, each built when it is first needed.

    Attributes:
        frames: tool and feet of the robot.
        damping: (n,) N·m·s/rad, dry_friction: (n,) N·m, of its joints.
    """

    def __init__(self, spec: RobotSpec, *, collisions: bool) -> None:
        """Read the model, find the pairs of shapes that can meet, and check the home pose.

        Raises:
            RobotError: as `load_pinocchio`, too many shapes, or the home pose is too near a singularity or a
                self-collision.
        """
        self._model, self._geometry = load_pinocchio(spec)
        self.damping, self.dry_friction = self._model.damping.copy(), self._model.friction.copy()
        self._margin, self._built = spec.margins.collision_m or 0.0, dict[int, Block]()
        tool, feet = tool_frame(spec, self._model), foot_frames(spec, self._model)
        self._tracked = [self._model.frames[frame] for frame in (*tool, *feet)]
        self.frames = _frames(spec, self._model, tool, feet)
        near = (*spec.neighbours, *(pair.bodies for pair in spec.may_touch))
        checked = collisions and "self_collision" in spec.capabilities
        try:
            pairs = collision_pairs(self._model, self._geometry, near) if checked else []
        except ValueError as e:
            raise RobotError(f"{spec.folder / 'robot.toml'}: capsules: {e}: declare fewer") from e
        check_home(spec, self._model, self._geometry, pairs)
        self._pairs = pairs_to_check(spec, self._model, self._geometry, pairs) if pairs else []

    def nearest_shapes(self, poses: Floats) -> tuple[float, str, str]:
        """Return the nearest shapes, as `Fleet.nearest_shapes`."""
        return nearest_shapes(self._model, self._geometry, self._pairs, poses)

    def least_gaps(self, poses: Floats) -> Floats:
        """Return the least gaps, as `Fleet.least_gaps`."""
        least = gaps(self._model, self._geometry, self._pairs, poses).min(axis=1, initial=np.inf)
        return np.asarray(least)

    def block(self, copies: int) -> Block:
        """Return the block of that many copies."""
        if copies not in self._built:
            model, frames = _side_by_side(self._model, self._tracked, copies)
            data = model.createData()
            pin.framesForwardKinematics(model, data, np.zeros(model.nq))
            points = strided_view([data.oMf[f].translation for f in frames]) if frames else np.zeros(0)
            collisions = (
                Collisions(self._model, self._geometry, self._pairs, copies, self._margin)
                if self._pairs
                else None
            )
            shape = (copies, len(self._tracked), 3)
            self._built[copies] = Block(
                model=model, data=data, points=points.reshape(shape), collisions=collisions
            )
        return self._built[copies]


def _frames(spec: RobotSpec, model: pin.Model, tool: list[int], feet: list[int]) -> Frames:
    carrying = np.flatnonzero(_carried_by(model, tool[0])) if tool else np.empty(0, dtype=np.int64)
    return Frames(
        has_tool=bool(tool),
        home_sign=np.sign(_home_manipulability(spec, model, tool[0], carrying)) if tool else 0.0,
        tool_joints=carrying,
        foot_joints=np.array([_carried_by(model, frame) for frame in feet], dtype=float).reshape(-1, spec.n),
        imu=imu_in_base(spec, model) if spec.base else np.zeros(3),
    )


def _carried_by(model: pin.Model, frame: int) -> Bools:
    supports = list(model.supports[model.frames[frame].parentJoint])
    return np.array([joint in supports for joint in range(1, model.njoints)])


def _home_manipulability(spec: RobotSpec, model: pin.Model, tool: int, carrying: Ints) -> float:
    q, least, found = spec.joint_array("q_home"), spec.margins.singularity, np.empty(1)
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, tool, pin.LOCAL_WORLD_ALIGNED)
    find_manipulability(jacobian[None], np.zeros((1, 3)), carrying, found)
    if least is not None and abs(found[0]) < least:
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: joints: q_home: manipulability there is {abs(found[0]):.2g}, expected at"
            f" least margins.singularity, {least}"
        )
    return float(found[0])


def _side_by_side(model: pin.Model, tracked: list[pin.Frame], copies: int) -> tuple[pin.Model, list[int]]:
    """Return a model of several copies of the robot at one place, and the tracked frames of each copy."""
    wide, frames = pin.Model(), []
    wide.gravity = model.gravity
    for number in range(copies):
        ids = [0]
        for j in range(1, model.njoints):
            placement, name = model.jointPlacements[j], f"{number}/{model.names[j]}"
            ids.append(wide.addJoint(ids[model.parents[j]], model.joints[j], placement, name))
            wide.appendBodyToJoint(ids[j], model.inertias[j], pin.SE3.Identity())
        for frame in tracked:
            name, joint = f"{number}/{frame.name}", ids[frame.parentJoint]
            same = pin.Frame(name, joint, 0, frame.placement, pin.FrameType.OP_FRAME)
            frames.append(wide.addFrame(same, False))
    wide.armature = np.tile(model.armature, copies)
    return wide, frames
