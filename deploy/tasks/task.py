"""Task: goals or commands of B robots, their progress, their success, and what a policy may observe of them.

The runtime, the judge and the training environment know a task by these members only. Tasks are found by the name in
a policy's contract among the entry points of the group `firstshift.tasks`; a package that declares one is enough.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from deploy.plugins import TASKS, installed, load
from deploy.sources.catalogue import SOURCES
from deploy.sources.source import ObservationSource
from deploy.stage import Stage
from deploy.state import Sample
from deploy.tasks.success import SuccessCriterion, SuccessEvaluation
from deploy.truth import Truth
from robots.arrays import Bools, Floats
from robots.capabilities import Capability
from robots.errors import ConfigError
from robots.randomness import Stream, generator_at, stream_keys
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime

FOR_EVER_S = 1e9


class Task(Stage, ABC):
    """Goals of B robots, each with G numbers, one period after another.

    `reached` counts by the robot's estimate; the judge counts by ground truth, by the same `success_criterion`.

    Attributes:
        goal: (B, G) the present goal. achieved: (B, G) estimate of what a goal is compared with.
        elapsed: (B,) ticks of the present period. number: (B,) goals given so far.
        attempted, reached: (B,) goals whose period ended, and those that were reached.
        ended: (B,) goals whose period ended in the last tick. ended_goal: (B, G) the last of them.
    """

    name: ClassVar[str]
    size: ClassVar[int]
    """G, numbers in a goal."""
    needs: ClassVar[frozenset[Capability]] = frozenset()
    """Capabilities without which a robot cannot do the task."""
    sources: ClassVar[Mapping[str, ObservationSource]] = {}
    """Observation sources that only this task has, by name."""
    command: ClassVar[tuple[str, ...]] = ()
    """Sources that tell its command, in order, of a task with which templates for commanded robots can be used."""
    observation: ClassVar[tuple[str, ...]] = (
        "joint_position",
        "joint_velocity",
        "target_offset",
        "last_action",
    )
    """Sources that a policy trained for the task observes by default, in order."""

    carried: ClassVar[tuple[str, ...]] = (
        *("goal", "achieved", "elapsed", "number", "attempted", "reached"),
        *("ended", "ended_goal"),
    )
    parts = ("success",)

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Give every robot its first goal; all goals follow from the B seeds."""
        self.spec, robots = spec, len(seeds)
        self.criterion = self.success_criterion(spec)
        self.success = SuccessEvaluation(self.criterion, robots, spec.dt)
        self._keys, self._period = stream_keys(seeds, Stream.GOALS), round(self.criterion.period_s / spec.dt)
        self.goal, self.achieved, self.ended_goal = np.zeros((3, robots, self.size))
        self._invisible = np.full((robots, 3), np.nan)
        self.elapsed, self.number, self.attempted, self.reached = np.zeros((4, robots), dtype=np.int64)
        self.ended = np.zeros(robots, dtype=bool)
        self._choose(np.ones(robots, dtype=bool))

    @classmethod
    def misfit(cls, spec: RobotSpec) -> str:
        """Return why a robot that has the capabilities cannot do the task, in words after "which"; else empty."""
        del spec
        return ""

    @classmethod
    @abstractmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """Return the criterion by which goals count as reached, by estimate and by ground truth alike."""

    @classmethod
    def limit_goal_period(cls, spec: RobotSpec, period_s: float) -> RobotSpec:
        """Return the robot with goals of at most `period_s` s, where the robot decides how long they last."""
        del period_s
        return spec

    @abstractmethod
    def true_achieved(self, truth: Truth) -> Floats:
        """Return (B, G) what a goal is compared with, from ground truth."""

    @abstractmethod
    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """Draw one goal (G,)."""

    @abstractmethod
    def observe(self, runtime: "Runtime", sample: Sample, due: bool) -> None:
        """Update `achieved`, and what else the task's sources read, from a new estimate; `due`: the policy observes."""

    @property
    def goal_position(self) -> Floats:
        """(B, 3) m in the world, of goals that cameras can see; NaN by default."""
        return self._invisible

    def start_poses(self, rng: np.random.Generator) -> Floats:
        """Draw (B, n) rad, poses in which training episodes begin; the home pose by default."""
        del rng
        return np.tile(self.spec.joint_array("q_home"), (len(self.goal), 1))

    def arm(self, ids: Bools) -> None:
        """React to robots `ids` (B,) being armed; goals stay by default."""

    def reset(self, ids: Bools) -> None:
        """Give a new goal and a full period to robots where `ids` (B,) holds."""
        self.elapsed[ids] = 0
        self.success.reset(ids)
        self._choose(ids)

    def step(self, running: Bools) -> None:
        """Count one tick; only robots `running` (B,) under their policy can reach a goal."""
        self.elapsed += 1
        np.greater_equal(self.elapsed, self._period, out=self.ended)
        success = self.success.step(self.achieved, self.goal, self.ended, running)
        if success is None:
            return
        self.attempted += self.ended
        self.reached += success
        self.ended_goal[self.ended] = self.goal[self.ended]
        self.reset(self.ended)

    def _choose(self, ids: Bools) -> None:
        for robot in np.flatnonzero(ids):
            self.goal[robot] = self.sample_goal(generator_at(self._keys[robot], int(self.number[robot])))
            self.number[robot] += 1


class NoGoal(Task):
    """Goals of no numbers, which never end: for any robot that is moved by hand or checked. Not for training."""

    name = "none"
    size = 0

    @classmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """One goal for ever."""
        del spec
        return SuccessCriterion(size=0, period_s=FOR_EVER_S, tolerance=0.0)

    @classmethod
    def true_achieved(cls, truth: Truth) -> Floats:
        """(B, 0)."""
        return np.zeros((len(truth.q), 0))

    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """(0,)."""
        del rng
        return np.zeros(0)

    def observe(self, runtime: "Runtime", sample: Sample, due: bool) -> None:
        """Nothing to update."""


def find_task(name: str, origin: str) -> type[Task]:
    """Return the task of that name in a contract, installed or `NoGoal`; `origin` is where it was named, for the error.

    Raises:
        ConfigError: no such task is installed.
    """
    if name == NoGoal.name:
        return NoGoal
    task: Any = load(TASKS, name, origin)
    return task  # type: ignore[no-any-return]


def sources_of(name: str) -> Mapping[str, ObservationSource]:
    """Return the observation sources of every robot and those of a task, by name.

    Raises:
        ConfigError: no such task is installed, or it declares a source that robots have.
    """
    task = find_task(name, f"task: found {name!r}")
    if twice := sorted(task.sources.keys() & SOURCES.keys()):
        raise ConfigError(f"task {name!r}: sources: found {', '.join(twice)}, which every robot has")
    return {**SOURCES, **task.sources}


def installed_sources() -> dict[str, ObservationSource]:
    """Return the observation sources of every robot and of every installed task, by name."""
    return {name: source for task in installed(TASKS) for name, source in sources_of(task).items()}


def tasks_of(spec: RobotSpec) -> tuple[str, ...]:
    """Return the names of the installed tasks that a robot can do."""
    tasks = {name: find_task(name, name) for name in installed(TASKS)}
    able = {name: task for name, task in tasks.items() if task.needs <= spec.capabilities}
    return tuple(name for name, task in able.items() if not task.misfit(spec))
