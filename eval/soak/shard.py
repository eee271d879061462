"""A shard: a fixed number of robots that live their hours together in one process.

Results are a function of seed, draw and `WIDTH` only: which process runs a shard, and when, changes nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.backend import simulate
from deploy.backends.sim.truth import Truth
from deploy.policy.contract import Contract
from deploy.policy.policy import Policy
from deploy.runtime import Runtime
from deploy.stage import Arrays, Stage, inside
from deploy.tasks.task import find_task
from eval.faults.fault_response import FaultResponses, FaultResponseTracker, saved_responses
from eval.faults.injector import Injector
from eval.faults.schedule import plan
from eval.judge.counts import Counts
from eval.judge.judge import Judge
from eval.soak.fingerprint import code_digest
from eval.soak.profile import Faults
from robots.arrays import Floats, Ints
from robots.draws import Draw
from robots.errors import ConfigError
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

WIDTH = 16
"""Robots in a shard, of which the last shard may count fewer: wide enough to share costs, narrow enough that 32
robots keep two cores busy."""
ARM_S = 0.2
"""s after which robots are armed for the first time: until then their estimators have not heard enough."""
LOOK_S = 1.0
"""s between two looks at progress, interruption and latched robots."""
OPERATOR_S = 60.0
"""s that a latched robot waits for its operator, who arms it again."""
KEEP_S = 300.0
"""s between two times that what was lived through is kept: about a minute of real time."""

Said = NDArray[np.floating] | None
"""(B, A) what a policy said, None where it was not its turn."""

COUNTED = ("attempted", "reached", "running", "stops", "latches")
"""What is sampled of `Counts`, as it stands by then."""
_SAMPLED = ("winding_c", "worn", "folded_back", *COUNTED, "events")


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardJob:
    """What a worker is told.

    Attributes:
        robot: folder. policy: file. robot_digest, policy_digest: of what they were when the soak began.
        seed: of the soak.
        first: index of the shard's first robot. robots: how many of its robots count.
        ticks: control ticks to live. sample_ticks: ticks between two samples.
        faults: on schedule; None for none.
        code_digest: of what ran when the job was made.
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
    faults: Faults | None = None
    code_digest: str = field(default_factory=code_digest)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardResult:
    """What a shard lived through, of the robots that count (R), and samples of it: at the start, then one by one.

    Attributes:
        counts: what the judge found.
        injections: what became of the faults on schedule.
        winding_c: (T, R, n) °C, true winding temperature; NaN where the simulation diverged, as in the next two.
        worn: (T, 4, R, n) what the joints had become by then, in the order of `Worn`.
        folded_back: (T, R, n) share of its current that a motor at work could not draw then, for its heat.
        attempted, reached: (T, R) goals up to then.
        running: (T, R) ticks under way up to then. stops, latches: (T, R) as in `Counts`, up to then.
        events: (T, R, monitors) up to then, all joints together.
    """

    counts: Counts
    injections: FaultResponses
    winding_c: Floats
    worn: Floats
    folded_back: Floats
    attempted: Ints
    reached: Ints
    running: Ints
    stops: Ints
    latches: Ints
    events: Ints


def judge_tick(judge: Judge, truth: Truth, runtime: Runtime, action: Said) -> None:
    """Show the judge the tick that has just ended.

    Args:
        judge: who is shown it.
        truth: of the robots now. runtime: what was believed, decided and sent.
        action: what the policy was heard to say; None where it was not its turn, or where nobody listened.
    """
    judge.step(
        truth=truth,
        state=runtime.state,
        observation=runtime.observation.frames,
        target=runtime.target,
        action=action,
        command=runtime.command,
        mode=runtime.supervisor.mode,
        reason=runtime.supervisor.reason,
        achieved=runtime.task.true_achieved(truth),
        goal=runtime.task.goal,
        attempted=runtime.task.attempted,
    )


def rearm(runtime: Runtime, after_s: float = OPERATOR_S) -> None:
    """The operator: arms latched robots after a while, and robots that were refused at the start."""
    supervisor = runtime.supervisor
    waiting = ~supervisor.powered & (supervisor.since >= round(after_s / runtime.spec.dt))
    if waiting.any():
        runtime.arm(waiting)


def _same(expected: str, found: str, what: object) -> None:
    if found != expected:
        raise ConfigError(
            f"{what}: changed during the soak: digest found {found:.12}, expected {expected:.12}"
        )


class Shard(Stage):
    """Runtime, simulated robots and judge of one job. What is saved is all that it lived through.

    Attributes:
        heard: what the policy was heard to say in the last tick. truth: what was true when it ended.
    """

    parts = ("runtime", "robot", "judge", "injector", "responses")

    truth: Truth

    def __init__(self, job: ShardJob, *, given: Draw | None = None) -> None:
        """Build everything; robots beyond those that count keep the width and are not reported.

        Args:
            job: what is asked for.
            given: the `WIDTH` robots as they are, in the place of those that the seeds would draw.
        """
        _same(job.code_digest, code_digest(), "firstshift's code")
        spec = load_robot(job.robot)
        _same(job.robot_digest, spec.digest, job.robot)
        seeds = [robot_seed(job.seed, job.first + row) for row in range(WIDTH)]
        policy = Policy.load(job.policy, spec)
        _same(job.policy_digest, policy.digest, job.policy)
        schedule = plan(spec, job.faults, seeds, job.first, job.ticks)
        self._job, faults = job, schedule.sensor_faults()
        self.runtime, self.robot = simulate(spec, policy.contract, seeds, policy, given=given, faults=faults)
        self.judge = judge_of(spec, policy.contract, job.robots)
        self.injector = Injector(spec, schedule, self.robot.plant, policy.contract.action_size)
        self.responses, self._policy = FaultResponseTracker(spec, schedule), policy
        self.heard: Said = None
        self._operator_s = job.faults.operator_s if job.faults else OPERATOR_S
        self._look, self._arm, self._keep = (round(s / spec.dt) for s in (LOOK_S, ARM_S, KEEP_S))
        self._samples: list[tuple[NDArray[np.generic], ...]] = []

    def run(
        self,
        progress: Callable[[int], None],
        stop: Callable[[], bool],
        keep: Callable[[], None] = lambda: None,
        watch: "Callable[[Shard], None]" = lambda _: None,
    ) -> ShardResult:
        """Live the hours, or what is left of them.

        Args:
            progress: told the ticks done so far.
            stop: whether to end now and report what there is.
            keep: called now and then, and at the end, to save what was lived through.
            watch: called after every tick.
        """
        begin = self.runtime.ticks
        progress(begin)
        if not self._samples:
            self.sample()
        for tick in range(begin, self._job.ticks):
            if tick > begin and tick % self._look == 0 and self._looked(tick, progress, stop, keep):
                break
            self.tick()
            watch(self)
            if (tick + 1) % self._job.sample_ticks == 0:
                self.sample()
        keep()
        progress(self.runtime.ticks)
        return shard_result(self.runtime.spec, self.runtime.contract, self._job.robots, self.save())

    def tick(self) -> None:
        """One tick of runtime, robots and judge. It ends with the operator's visit, where one is due."""
        if self.runtime.ticks == self._arm:
            self.runtime.arm(np.ones(WIDTH, dtype=bool))
        self._live(self.runtime.ticks)
        if self.runtime.ticks % self._look == 0:
            rearm(self.runtime, self._operator_s)

    def _live(self, tick: int) -> None:
        """The runtime's tick, with what the schedule breaks in the robot and in what the policy says."""
        runtime, mode = self.runtime, self.runtime.supervisor.mode
        self.responses.begin(tick, mode, self.judge)
        self.injector.step(tick)
        observation = runtime.sense()
        said = None if observation is None else self._policy.step(observation)
        self.heard = said if said is None else self.injector.action(said, tick // runtime.decimation)
        runtime.act(self.heard)
        self.truth = self.robot.truth()
        judge_tick(self.judge, self.truth, runtime, self.heard)
        if self.responses.following:
            self.responses.step(tick, self.truth, runtime.command, mode, self.judge)

    def _looked(
        self, tick: int, progress: Callable[[int], None], stop: Callable[[], bool], keep: Callable[[], None]
    ) -> bool:
        """Whether to end before `tick`."""
        progress(tick)
        if tick % self._keep == 0:
            keep()
        return stop()

    def snapshot(self) -> Arrays:
        """Copies of what decides all ticks to come, without what is sampled of those that were."""
        return super().save()

    def save(self) -> Arrays:
        """Copies of everything, to go on from."""
        columns = zip(_SAMPLED, zip(*self._samples, strict=True), strict=True)
        return self.snapshot() | {f"sampled.{name}": np.stack(values) for name, values in columns}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit; of a snapshot, sampling begins anew."""
        super().restore(arrays)
        sampled = _sampled(arrays) if f"sampled.{_SAMPLED[0]}" in arrays else {}
        self._samples = list(zip(*sampled.values(), strict=True))

    def live_again(self, state: Arrays, watch: Callable[[], None]) -> None:
        """From an earlier snapshot to the present tick once more; `watch` is called after every tick."""
        end, samples = self.runtime.ticks, self._samples
        self.restore(state)
        self._samples = samples
        while self.runtime.ticks < end:
            self.tick()
            watch()

    def sample(self) -> None:
        """Keep what a `ShardResult` shows of this moment."""
        truth, counts, rows = self.robot.truth(), self.judge.counts(), slice(0, self._job.robots)
        known, folded_back = (
            truth.valid[:, None],
            1.0 - self.runtime.estimator.windings.foldback.current_share,
        )
        winding, folded_back = (np.where(known, x, np.nan)[rows] for x in (truth.winding_c, folded_back))
        worn = np.where(known, np.stack(self.robot.plant.worn()), np.nan)[:, rows]
        counted = (getattr(counts, name) for name in COUNTED)
        self._samples.append((winding, worn, folded_back, *counted, counts.by_monitor()))


def shard_result(spec: RobotSpec, contract: Contract, robots: int, saved: Mapping[str, Any]) -> ShardResult:
    """What a shard that was saved had lived through, of the robots that count.

    Args:
        spec: the robot. contract: the policy's. robots: how many count.
        saved: by `Shard.save`.
    """
    judge = judge_of(spec, contract, robots)
    judge.restore(inside(saved, "judge"))
    responses = saved_responses(inside(saved, "responses"), robots)
    return ShardResult(counts=judge.counts(), injections=responses, **_sampled(saved))


def _sampled(saved: Mapping[str, Any]) -> dict[str, Any]:
    return {name: saved[f"sampled.{name}"] for name in _SAMPLED}


def judge_of(spec: RobotSpec, contract: Contract, robots: int) -> Judge:
    """The judge of a shard of which so many robots count, before its first tick."""
    scoring = find_task(contract.task, "contract: task").scoring(spec)
    return Judge(spec, torque_max(spec), WIDTH, scoring=scoring, counted=robots, observed=contract.observed)
