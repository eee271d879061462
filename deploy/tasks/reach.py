"""Reach: bring the tool to one point after another."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from deploy.observation_sources import ObservationSource
from deploy.state import Sample
from deploy.tasks.goal_pool import ReachConfig, goal_pool
from deploy.tasks.success import SuccessCriterion
from deploy.tasks.task import Task
from deploy.truth import Truth
from robots.arrays import Floats
from robots.capabilities import Capability
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime

GOAL_TIMEOUT_S = 1.0
"""s without a packet of the goal camera after which a goal counts as unknown: the tool then stays where it is."""


def _torque_to_goal(runtime: "Runtime") -> Floats:
    """(B, n) N·m, joint torques of a spring of 1 N/m that pulls the tool to the goal."""
    return runtime.tool.joint_torque(_camera_goal(runtime) - runtime.tool.position)


def _camera_goal(runtime: "Runtime") -> Floats:
    task = runtime.task
    if not isinstance(task, Reach):
        raise RuntimeError(f"task {task.name} has no goal that a camera sees")
    return task.camera_goal


class Reach(Task):
    """Tool positions in the world, m, drawn from the pool of reachable goals.

    Attributes:
        camera_goal: (B, 3) m, the goal as the camera saw it last; the tool's position where it is unknown.
    """

    name = "reach"
    size = 3
    needs: ClassVar[frozenset[Capability]] = frozenset({"tool", "workspace"})
    config: ClassVar[ReachConfig] = ReachConfig()
    carried: ClassVar[tuple[str, ...]] = (*Task.carried, "camera_goal")
    sources: ClassVar[Mapping[str, ObservationSource]] = {
        "goal_position": ObservationSource("world", "m", 3, _camera_goal, "goal camera", ("goal",)),
        "goal_from_tool": ObservationSource(
            "world", "m", 3, lambda r: _camera_goal(r) - r.tool.position, "goal camera and encoder", ("goal",)
        ),
        "goal_torque": ObservationSource(
            "joint", "N·m", None, _torque_to_goal, "goal camera and encoder", ("goal",)
        ),
    }

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        self.pool, self.camera_goal = goal_pool(spec, self.config), np.zeros((len(seeds), 3))
        super().__init__(spec, seeds)

    @classmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """Within `tolerance_m` when the period ends."""
        return SuccessCriterion(size=3, period_s=cls.config.period_s, tolerance=cls.config.tolerance_m)

    @classmethod
    def true_achieved(cls, truth: Truth) -> Floats:
        """(B, 3) m, the tool in the world."""
        return truth.tool_position

    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """(3,) m, uniform in the volume of the pool."""
        goal: Floats = self.pool.tool[np.searchsorted(self.pool.cumulative_probability, rng.random())]
        return goal

    def observe(self, runtime: "Runtime", sample: Sample, due: bool) -> None:
        """Read tool and camera when the policy is due."""
        if not due:
            return
        self.achieved[:] = runtime.tool.position
        if "goal" in sample:
            packet = sample["goal"]
            stale = runtime.t - packet.t > GOAL_TIMEOUT_S
            known = np.isfinite(packet.value) & ~stale[:, None]
            self.camera_goal[:] = np.where(known, packet.value, self.achieved)

    @property
    def goal_position(self) -> Floats:
        """(B, 3) m in the world."""
        return self.goal

    def start_poses(self, rng: np.random.Generator) -> Floats:
        """(B, n) rad, joint configurations of the pool."""
        q: Floats = self.pool.q[rng.integers(len(self.pool.q), size=len(self.goal))]
        return q

    @classmethod
    def observation_scales(
        cls, spec: RobotSpec, *, reach_m: float, leash_rad: float
    ) -> dict[str, list[float]]:
        """Tool, goal and the torque towards it beside what every task has."""
        joints = super().observation_scales(spec, reach_m=reach_m, leash_rad=leash_rad)
        return {
            "joint_position": joints["joint_position"],
            "joint_velocity": joints["joint_velocity"],
            "tool_position": [reach_m] * 3,
            "goal_from_tool": [reach_m] * 3,
            "goal_torque": [reach_m**2] * spec.n,
            "target_offset": joints["target_offset"],
            "last_action": joints["last_action"],
        }
