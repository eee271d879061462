"""Common part of tasks whose goals are tool positions seen by a camera."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from deploy.sources.maximum import REACH, REACH_SQUARED, sensor_range
from deploy.sources.readings import SILENT_S, sensor_reading
from deploy.sources.source import ObservationSource
from deploy.state import Sample
from deploy.tasks.task import Task
from deploy.truth import Truth
from robots.arrays import Floats
from robots.capabilities import Capability
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime


def _torque_to_goal(runtime: "Runtime") -> Floats:
    """(B, n) N·m, joint torques of a spring of 1 N/m that pulls the tool to the goal."""
    return runtime.tool.joint_torque(_camera_goal(runtime) - runtime.tool.position)


def _camera_goal(runtime: "Runtime") -> Floats:
    task = runtime.task
    if not isinstance(task, ToolGoals):
        raise RuntimeError(f"task {task.name} has no goal that a camera sees")
    return task.camera_goal


def _distance(runtime: "Runtime") -> Floats:
    return sensor_reading(runtime, "distance", missing=runtime.spec.sensors["distance"].range)


class ToolGoals(Task):
    """Goals are tool positions in the world, m.

    Attributes:
        camera_goal: (B, 3) m, the goal as the camera saw it last; the tool's position where it is unknown.
    """

    size = 3
    needs: ClassVar[frozenset[Capability]] = frozenset({"tool"})
    carried: ClassVar[tuple[str, ...]] = (*Task.carried, "camera_goal")
    sources: ClassVar[Mapping[str, ObservationSource]] = {
        "goal_position": ObservationSource(
            frame="world",
            unit="m",
            size=3,
            sensing="exteroceptive",
            maximum=REACH,
            read=_camera_goal,
            meaning="goal: goal camera; the tool while it has seen none for 1 s",
            sensors=("goal",),
        ),
        "goal_from_tool": ObservationSource(
            frame="world",
            unit="m",
            size=3,
            sensing="exteroceptive",
            maximum=REACH,
            read=lambda runtime: _camera_goal(runtime) - runtime.tool.position,
            meaning="goal minus tool: goal camera and encoder",
            sensors=("goal",),
        ),
        "goal_torque": ObservationSource(
            frame="joint",
            unit="N·m",
            each="joint",
            sensing="exteroceptive",
            maximum=REACH_SQUARED,
            read=_torque_to_goal,
            meaning="joint torques of a spring of 1 N/m from tool to goal: goal camera and encoder",
            sensors=("goal",),
        ),
        "goal_distance": ObservationSource(
            frame="sensor",
            unit="m",
            sensing="exteroceptive",
            maximum=sensor_range("distance"),
            read=_distance,
            meaning="distance of the goal from the distance sensor; its range without reading, as while a link is in"
            " between",
            sensors=("distance",),
        ),
    }

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        self.camera_goal = np.zeros((len(seeds), 3))
        super().__init__(spec, seeds)

    @classmethod
    def true_achieved(cls, truth: Truth) -> Floats:
        """(B, 3) m, the tool in the world."""
        return truth.tool_position

    def observe(self, runtime: "Runtime", sample: Sample, due: bool) -> None:
        """Read tool and camera when the policy is due."""
        if not due:
            return
        self.achieved[:] = runtime.tool.position
        if "goal" in sample:
            packet = sample["goal"]
            stale = runtime.t - packet.t > SILENT_S
            known = np.isfinite(packet.value) & ~stale[:, None]
            self.camera_goal[:] = np.where(known, packet.value, self.achieved)

    @property
    def goal_position(self) -> Floats:
        """(B, 3) m in the world."""
        return self.goal
