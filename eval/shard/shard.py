"""Shard: a fixed number of robots simulated together in one process.

Results are a function of seed, draw and `WIDTH` only; the process that runs a shard and the time do not matter.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from deploy.masks import any_true
from deploy.operation.overrun import Overrun
from deploy.policy.actor import Actor
from deploy.policy.compatibility import sensors_read
from deploy.policy.policy import Policy
from deploy.policy.policy_file import read_policy_file
from deploy.reasons import Reason
from deploy.runtime import Runtime
from deploy.simulation import simulate
from deploy.stage import Arrays, Stage
from deploy.truth import Truth
from eval.faults.fault_response import FaultResponseTracker
from eval.faults.injector import Injector
from eval.faults.schedule import plan
from eval.judge.limits import load_limits
from eval.shard.job import ARM_S, OPERATOR_S, POLL_S, WIDTH, ShardJob, code_digest
from eval.shard.judging import (
    COUNTED,
    SAMPLED,
    Action,
    ShardResult,
    judge_tick,
    make_judge,
    samples,
    shard_result,
)
from robots.distributions import load_distributions
from robots.draws import Draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

CHECKPOINT_S = 300.0
"""s of simulated time between two checkpoints: about a minute of real time."""


def rearm(runtime: Runtime, delay_s: float = OPERATOR_S) -> None:
    """Arm robots that have been without power for `delay_s`: latched ones, and those refused at the start."""
    supervisor = runtime.supervisor
    waiting = ~supervisor.powered & (supervisor.since >= round(delay_s / runtime.spec.dt))
    if waiting.any():
        runtime.arm(waiting)


def _check_digest(expected: str | None, found: str, what: object) -> None:
    if expected is not None and found != expected:
        raise ConfigError(
            f"{what}: changed during the soak: digest found {found:.12}, expected {expected:.12}"
        )


def check_robot(job: ShardJob, spec: RobotSpec) -> None:
    """Check that a robot, as its files are now, is the one of a job.

    Raises:
        ConfigError: it changed since the job was made.
    """
    _check_digest(job.robot_digest, spec.digest, job.robot)
    _check_digest(job.draws_digest, load_distributions(spec).digest, job.robot / "draws.toml")
    _check_digest(job.limits_digest, load_limits(spec).digest, job.robot / "limits.toml")


class Shard(Stage):
    """Runtime, simulated robots, judge and fault injection of one job. `save` holds everything.

    Attributes:
        action: output of the policy in the last tick, after injected faults. truth: ground truth after that tick.
        checkpoint_ticks: between two checkpoints. policy_data: content of the policy's file.
    """

    parts = ("runtime", "robot", "judge", "injector", "responses", "overrun")

    action: Action
    truth: Truth

    def __init__(self, job: ShardJob, *, draw: Draw | None = None) -> None:
        """Build all parts. Robots beyond those that count only fill up the width and are not reported.

        `draw` replaces the parameters of the `WIDTH` robots that the seeds would draw.

        Raises:
            ConfigError: code, robot, policy, draws or limits changed since the job was made.
        """
        _check_digest(job.code_digest, code_digest(), "firstshift's code")
        spec = load_robot(job.robot)
        check_robot(job, spec)
        seeds = [robot_seed(job.seed, job.first + row) for row in range(WIDTH)]
        file = read_policy_file(job.policy)
        _check_digest(job.policy_digest, file.digest, job.policy)
        policy = Policy.verified(file, str(job.policy), spec)
        self._policy: Actor = policy
        self.policy_data = file.data
        schedule = plan(spec, sensors_read(policy.contract, spec), job.faults, seeds, job.first, job.ticks)
        self._job, self.action, faults = job, None, schedule.sensor_faults()
        self.runtime, self.robot = simulate(spec, policy.contract, seeds, policy, draw=draw, faults=faults)
        self.judge = make_judge(spec, policy.contract, WIDTH, counted=job.robots)
        self.injector = Injector(spec, schedule, self.robot.plant, policy.contract.action_size)
        self.responses = FaultResponseTracker(spec, schedule)
        self.overrun = Overrun(WIDTH, spec.rates.control_hz)
        usual_s = job.faults.operator_s if job.faults else OPERATOR_S
        self._operator_s = usual_s if job.operator_s is None else job.operator_s
        self._poll, self._arm = (round(s / spec.dt) for s in (POLL_S, ARM_S))
        self.checkpoint_ticks = round(CHECKPOINT_S / spec.dt)
        self._samples: list[tuple[NDArray[np.generic], ...]] = []

    def run(
        self,
        progress: Callable[[int], None],
        stop: Callable[[], bool],
        checkpoint: Callable[[], None] = lambda: None,
        observe: "Callable[[Shard], None]" = lambda _: None,
    ) -> ShardResult:
        """Simulate the job's ticks, or what is left of them.

        Args:
            progress: called with the ticks done so far.
            stop: returns True to end early.
            checkpoint: called at intervals and at the end, to save the shard.
            observe: called after every tick.
        """
        begin = self.runtime.ticks
        progress(begin)
        if not self._samples:
            self.sample()
        for tick in range(begin, self._job.ticks):
            if tick > begin and tick % self._poll == 0:
                progress(tick)
                if tick % self.checkpoint_ticks == 0:
                    checkpoint()
                if stop():
                    break
            self.tick()
            observe(self)
            if (tick + 1) % self._job.sample_ticks == 0:
                self.sample()
        checkpoint()
        progress(self.runtime.ticks)
        return shard_result(self.runtime.spec, self.runtime.contract, self._job.robots, self.save())

    def tick(self) -> None:
        """Advance runtime, robots and judge by one tick; then arm robots where it is due.

        They are armed after the tick: arming reads the tick's estimates, which a snapshot does not hold.
        """
        self._step(self.runtime.ticks)
        if self.runtime.ticks == self._arm:
            self.runtime.arm(np.ones(WIDTH, dtype=bool))
        if self.runtime.ticks % self._poll == 0:
            rearm(self.runtime, self._operator_s)

    def _step(self, tick: int) -> None:
        """Runtime's tick, with scheduled faults in the robots and in the policy's output."""
        runtime, mode = self.runtime, self.runtime.supervisor.mode
        self.responses.begin(tick, mode, self.judge)
        self.injector.step(tick)
        self._tell_late_ticks()
        observation = runtime.sense()
        action = None if observation is None else self._policy.step(observation)
        self.action = action if action is None else self.injector.action(action, tick // runtime.decimation)
        runtime.act(self.action)
        self.truth = self.robot.truth()
        judge_tick(self.judge, self.truth, runtime, self.action)
        if self.responses.following:
            self.responses.step(tick, self.truth, runtime.command, mode, self.judge)

    def set_policy(self, policy: Actor) -> None:
        """Replace the policy by another actor of the same contract, with an empty memory."""
        self._policy = self.runtime.policy = policy
        policy.resize(WIDTH)

    def _tell_late_ticks(self) -> None:
        """Do what `deploy.operation` does before a tick: stop after an overrun, count and tell of skipped slots."""
        overrun, late = self.overrun.overrun, self.robot.plant.late
        if any_true(overrun):
            self.runtime.stop(Reason.OVERRUN, overrun)
        self.overrun.step(late)
        if any_true(late):
            self.runtime.skip(late)

    def snapshot(self) -> Arrays:
        """Copies of the state that decides all further ticks, without the samples taken so far."""
        return super().save()

    def save(self) -> Arrays:
        """Copies of state and samples, to resume from."""
        columns = zip(SAMPLED, zip(*self._samples, strict=True), strict=True)
        return self.snapshot() | {f"sampled.{name}": np.stack(values) for name, values in columns}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore saved arrays bit for bit; a snapshot has no samples, so that sampling starts again."""
        super().restore(arrays)
        self._samples = list(zip(*samples(arrays).values(), strict=True))

    def resimulate(self, state: Arrays, observe: Callable[[], None]) -> None:
        """Restore an earlier snapshot and simulate again up to the present tick; `observe` is called every tick."""
        end, samples_so_far = self.runtime.ticks, self._samples
        self.restore(state)
        self._samples = samples_so_far
        while self.runtime.ticks < end:
            self.tick()
            observe()

    def sample(self) -> None:
        """Append a sample of every `ShardResult` array over time."""
        truth, counts, rows = self.robot.truth(), self.judge.counts(), slice(0, self._job.robots)
        known = truth.valid[:, None]
        folded_back = 1.0 - self.runtime.estimator.windings.foldback.current_share
        winding, folded_back = (np.where(known, x, np.nan)[rows] for x in (truth.winding_c, folded_back))
        worn = np.where(known, np.stack(self.robot.plant.wear.worn()), np.nan)[:, rows]
        counted = (getattr(counts, name) for name in COUNTED)
        self._samples.append((winding, worn, folded_back, *counted, counts.by_monitor()))
