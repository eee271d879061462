"""A shard: a fixed number of robots that live their hours together in one process.

Results are a function of seed, draw and `WIDTH` only: which process runs a shard, and when, changes nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.robot import SimRobot
from deploy.policy import Policy
from deploy.runtime import Runtime
from deploy.stage import Arrays, Stage
from deploy.tasks.reach import ReachConfig
from eval.counts import Counts, first
from eval.monitors import Judge
from robots.errors import ConfigError
from robots.model_pinocchio import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

WIDTH = 8
"""Robots in a shard, of which the last shard may count fewer: wide enough to share costs, narrow enough that 16
robots keep two cores busy."""
ARM_S = 0.2
"""s after which robots are armed for the first time: until then their estimators have not heard enough."""
LOOK_S = 1.0
"""s between two looks at progress, interruption and latched robots."""
OPERATOR_S = 60.0
"""s that a latched robot waits for its operator, who arms it again."""
KEEP_S = 300.0
"""s between two times that what was lived through is kept: about a minute of real time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardJob:
    """What a worker is told.

    Attributes:
        robot: folder. policy: file. robot_digest, policy_digest: of what they were when the soak began.
        seed: of the soak.
        first: index of the shard's first robot. robots: how many of its robots count.
        ticks: control ticks to live. sample_ticks: ticks between two samples of heat, wear and goals.
    """

    robot: Path
    policy: Path
    robot_digest: str
    policy_digest: str
    seed: int
    first: int
    robots: int
    ticks: int
    sample_ticks: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardResult:
    """What a shard lived through, of the robots that count (R).

    Attributes:
        counts: what the judge found.
        winding_c: (T, R, n) °C, true winding temperature at the start and at each sample; NaN where the simulation
            diverged, as in `worn`.
        worn: (T, 4, R, n) what the joints had become by then, in the order of `Worn`.
        attempted, reached: (T,) goals up to then, all robots together.
    """

    counts: Counts
    winding_c: NDArray[np.float64]
    worn: NDArray[np.float64]
    attempted: NDArray[np.int64]
    reached: NDArray[np.int64]


def judge_tick(judge: Judge, robot: SimRobot, runtime: Runtime) -> None:
    """Show the judge the tick that has just ended."""
    judge.step(
        truth=robot.truth(),
        target=runtime.target,
        command=runtime.command,
        mode=runtime.supervisor.mode,
        reason=runtime.supervisor.reason,
        goal=runtime.task.goal,
        attempted=runtime.task.attempted,
    )


def rearm(runtime: Runtime) -> None:
    """The operator: arms latched robots after a while, and robots that were refused at the start."""
    supervisor = runtime.supervisor
    waiting = ~supervisor.powered & (supervisor.since >= round(OPERATOR_S / runtime.spec.dt))
    if waiting.any():
        runtime.arm(waiting)


def _same(expected: str, found: str, path: Path) -> None:
    if found != expected:
        raise ConfigError(
            f"{path}: changed during the soak: digest found {found:.12}, expected {expected:.12}"
        )


_SAMPLED = ("winding_c", "worn", "attempted", "reached")


class Shard(Stage):
    """Runtime, simulated robots and judge of one job. What is saved is all that it lived through."""

    parts = ("runtime", "robot", "judge")

    def __init__(self, job: ShardJob) -> None:
        """Build everything; robots beyond those that count keep the width and are not reported."""
        spec = load_robot(job.robot)
        _same(job.robot_digest, spec.digest, job.robot)
        seeds = [robot_seed(job.seed, job.first + row) for row in range(WIDTH)]
        policy = Policy.load(job.policy, spec)
        _same(job.policy_digest, policy.digest, job.policy)
        self._job, self.robot = job, SimRobot(spec, seeds)
        self.runtime, self.judge = Runtime(spec, policy.contract, self.robot, seeds, policy), _judge(spec)
        self._look, self._arm, self._keep = (round(s / spec.dt) for s in (LOOK_S, ARM_S, KEEP_S))
        self._samples: list[tuple[NDArray[np.generic], ...]] = []

    def run(
        self,
        progress: Callable[[int], None],
        stop: Callable[[], bool],
        keep: Callable[[], None] = lambda: None,
    ) -> ShardResult:
        """Live the hours, or what is left of them.

        Args:
            progress: told the ticks done so far.
            stop: whether to end now and report what there is.
            keep: called now and then, and at the end, to save what was lived through.
        """
        begin = self.runtime.ticks
        progress(begin)
        if not self._samples:
            self._sample()
        for tick in range(begin, self._job.ticks):
            if tick == self._arm:
                self.runtime.arm(np.ones(WIDTH, dtype=bool))
            if tick > begin and tick % self._look == 0 and self._looked(tick, progress, stop, keep):
                break
            self.runtime.tick()
            judge_tick(self.judge, self.robot, self.runtime)
            if (tick + 1) % self._job.sample_ticks == 0:
                self._sample()
        keep()
        progress(self.runtime.ticks)
        return shard_result(self.runtime.spec, self._job.robots, self.save())

    def _looked(
        self, tick: int, progress: Callable[[int], None], stop: Callable[[], bool], keep: Callable[[], None]
    ) -> bool:
        """Whether to end before `tick`. What is kept has its operator's visit behind it."""
        progress(tick)
        rearm(self.runtime)
        if tick % self._keep == 0:
            keep()
        return stop()

    def save(self) -> Arrays:
        """Copies of everything, to go on from."""
        columns = zip(_SAMPLED, zip(*self._samples, strict=True), strict=True)
        return super().save() | {f"sampled.{name}": np.stack(values) for name, values in columns}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit."""
        super().restore(arrays)
        self._samples = list(zip(*_sampled(arrays).values(), strict=True))

    def _sample(self) -> None:
        truth, counts, rows = self.robot.truth(), self.judge.counts(), slice(0, self._job.robots)
        known = truth.valid[:, None]
        winding = np.where(known, truth.winding_c, np.nan)[rows]
        worn = np.where(known, np.stack(self.robot.plant.worn()), np.nan)[:, rows]
        self._samples.append((winding, worn, counts.attempted[rows].sum(), counts.reached[rows].sum()))


def shard_result(spec: RobotSpec, robots: int, saved: Mapping[str, Any]) -> ShardResult:
    """What a shard that was saved had lived through, of the robots that count.

    Args:
        spec: the robot. robots: how many count.
        saved: by `Shard.save`.
    """
    judge = _judge(spec)
    judge.restore(
        {name.removeprefix("judge."): array for name, array in saved.items() if name.startswith("judge.")}
    )
    return ShardResult(counts=first(judge.counts(), robots), **_sampled(saved))


def _sampled(saved: Mapping[str, Any]) -> dict[str, Any]:
    return {name: saved[f"sampled.{name}"] for name in _SAMPLED}


def _judge(spec: RobotSpec) -> Judge:
    return Judge(spec, torque_max(spec), WIDTH, goal_s=ReachConfig().period_s)
