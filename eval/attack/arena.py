"""Arena: a shard in which one adversary after another is tried, each from the same beginning."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from deploy.masks import any_true
from deploy.policy.actor import Actor
from deploy.policy.policy import Policy
from deploy.policy.policy_file import PolicyFile
from eval.attack.adversaries import ADVERSARIES, Effect
from eval.attack.candidate import Block, Candidate
from eval.attack.crowd import Crowd
from eval.attack.falls import OF_FALLS, Falls
from eval.attack.guards import remove_guard
from eval.attack.loaded_robots import loaded_robots, loaded_shard
from eval.attack.policy_graph import policy_file
from eval.attack.pushed_arm import PushedArm, gains_of
from eval.attack.trained_gains import TrainedGains
from eval.attack.weights import Weights
from eval.faults.schedule import FIRST_S, LEAST_CYCLE_S, FaultSettings
from eval.judge.counts import Counts
from eval.replay.bundle import POLICY
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from robots.arrays import Bools, Floats
from robots.distributions import load_distributions
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec, load_robot

EPISODE_S, FAULTY_EPISODE_S = 5.0, 10.0
"""s that a candidate is tried: long enough to throw an arm from one end of its range to the other, and for a stop with
its end. With faults, one begins in each robot after 3 to 5 s."""
REARM_S = 0.5
"""s after which a robot that latched is armed again: it must not rest for the rest of its trial."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Settings of an attack, the same for all candidates.

    Attributes:
        robot: folder. mode: in which drives follow the policy.
        faults: names of fault classes, of which one is injected into each robot; empty for none.
        without: part of the description of a guard's removal (`make mutants` lists them); empty: no guard is removed.
        gains: of the drives; None for their own, or those of an adversary's weights.
        loaded: robots are those of `loaded_robots` and worn, else those that a soak of the seed draws. Those of pushed
            arms are neither.
    """

    robot: Path
    mode: ControlMode
    faults: tuple[str, ...] = ()
    without: str = ""
    gains: TrainedGains | None = None
    loaded: bool = True

    @property
    def seconds(self) -> float:
        """Length of a trial, s."""
        return FAULTY_EPISODE_S if self.faults else EPISODE_S

    def ticks(self, spec: RobotSpec) -> int:
        """Return the control ticks of a trial."""
        return round(self.seconds / spec.dt)

    @property
    def fault_settings(self) -> FaultSettings | None:
        """Settings of the fault injection, if there is any."""
        if not self.faults:
            return None
        return FaultSettings(coverage=0.95, cycle_s=LEAST_CYCLE_S, operator_s=REARM_S, classes=self.faults)

    def contract_gains(self, weights: Weights, spec: RobotSpec) -> TrainedGains | None:
        """Return the drive gains in the contract of some weights; None for the drives' own."""
        return self.gains or gains_of(weights, spec, self.mode)


class Outcome(NamedTuple):
    """Outcome of a trial.

    Attributes:
        worst: (B,) highest ratio of every joint, by the names of the robot's monitors; of a robot that fell, until it
            fell. diverged: (B,) simulations.
    """

    worst: dict[str, Floats]
    diverged: Bools


class Arena:
    """Shard of `WIDTH` robots of one seed. What is tried there changes nothing for what is tried later."""

    def __init__(self, setting: Setting, seed: int, effect: Effect | None = None) -> None:
        """Build the shard, of the arm that an effect chooses or of the setting's robots, with its guard removed."""
        self._spec, self._setting = load_robot(setting.robot), setting
        with TemporaryDirectory() as folder:
            job = write_job(setting, self._spec, Candidate("", {}, seed), Path(folder) / POLICY)
            self._arm = PushedArm(job, self._spec, effect) if effect else None
            self._shard = self._arm.shard if self._arm else _shard_of_many(setting, job)
        remove_guard(setting.without, self._shard.runtime)
        self._start = self._shard.snapshot()

    def try_block(self, block: Block) -> Outcome:
        """Let every robot try its own policy."""
        file = policy_file(self._spec, self._setting.mode, block.rows, self._setting.gains)
        return self._run(Crowd(file), block.rows)

    def try_candidate(self, candidate: Candidate) -> Outcome:
        """Let all robots try one policy, as its file would be run."""
        file = _file(self._setting, self._spec, candidate)
        return self._run(Policy(file, candidate.adversary), (candidate.weights,) * WIDTH)

    def _run(self, policy: Actor, rows: Sequence[Weights]) -> Outcome:
        shard = self._shard
        shard.set_policy(policy)
        shard.restore(self._start)
        if self._arm:
            self._arm.stiffen([self._setting.contract_gains(row, self._spec) for row in rows])
            self._arm.push(rows)
        falls, at_fall = Falls(self._spec, WIDTH), dict[str, Floats]()
        for _ in range(self._setting.ticks(self._spec)):
            shard.tick()
            fell = falls.step(shard.truth, shard.runtime.supervisor.powered)
            if any_true(fell):
                now = _worst(shard.judge.counts())
                at_fall = {
                    name: np.where(fell, now[name], before) for name, before in (at_fall or now).items()
                }
        counts = shard.judge.counts()
        worst = _worst(counts)
        for name in at_fall.keys() - {*OF_FALLS}:
            np.copyto(worst[name], at_fall[name], where=falls.fallen)
        return Outcome(worst, counts.invalid > 0)


def find_mode(name: str, spec: RobotSpec) -> ControlMode:
    """Return a control mode of a robot by its name.

    Raises:
        ConfigError: its drives do not have it.
    """
    modes = {mode.name.lower(): mode for mode in spec.control_modes}
    if name not in modes:
        raise ConfigError(f"--mode: found {name!r}, expected one of those of {spec.name}: {', '.join(modes)}")
    return modes[name]


def _worst(counts: Counts) -> dict[str, Floats]:
    """Return (B,) the highest ratio of every monitor's joints, by its name."""
    return {m.name: counts.worst[:, counts.columns(m.name)].max(axis=1) for m in counts.monitors}


def _file(setting: Setting, spec: RobotSpec, candidate: Candidate) -> PolicyFile:
    gains = setting.contract_gains(candidate.weights, spec)
    return policy_file(spec, setting.mode, (candidate.weights,), gains)


def write_job(setting: Setting, spec: RobotSpec, candidate: Candidate, policy: Path) -> ShardJob:
    """Write the policy of a candidate to a file, and return the job of a shard that it moves."""
    file = _file(setting, spec, candidate)
    policy.write_bytes(file.data)
    seconds = FIRST_S + LEAST_CYCLE_S if setting.faults else setting.seconds  # a fault needs its whole slot
    ticks = round(seconds / spec.dt)
    return ShardJob(
        robot=spec.folder,
        policy=policy,
        robot_digest=spec.digest,
        policy_digest=file.digest,
        seed=candidate.seed,
        first=0,
        robots=WIDTH,
        ticks=ticks,
        sample_ticks=ticks,
        faults=setting.fault_settings,
        operator_s=REARM_S,
    )


def make_shard(setting: Setting, job: ShardJob, candidate: Candidate) -> Shard:
    """Return the shard of a candidate's job, with its arm and push, or with the robots of the setting."""
    if not (effect := ADVERSARIES[candidate.adversary].effect):
        return _shard_of_many(setting, job)
    arm = PushedArm(job, load_robot(setting.robot), effect)
    arm.push((candidate.weights,) * WIDTH)
    return arm.shard


def _shard_of_many(setting: Setting, job: ShardJob) -> Shard:
    if not setting.loaded:
        return Shard(job)
    spec = load_robot(setting.robot)
    return loaded_shard(job, loaded_robots(load_distributions(spec), spec, job.seed))


ARENAS = 1 + sum(len(each.targets) for each in ADVERSARIES.values())
"""Arenas that a search alternates between: of the robots of a seed, and of each pushed arm; 80 to 100 MB each."""


@lru_cache(maxsize=ARENAS)
def _arena(setting: Setting, seed: int, effect: Effect | None) -> Arena:
    return Arena(setting, seed, effect)


def try_block(setting: Setting, block: Block) -> Outcome:
    """Try a block in this process, which keeps its last arenas."""
    return _arena(setting, block.seed, ADVERSARIES[block.adversary].effect).try_block(block)


def try_candidate(setting: Setting, candidate: Candidate) -> Outcome:
    """Try a candidate in this process, which keeps its last arenas."""
    return _arena(setting, candidate.seed, ADVERSARIES[candidate.adversary].effect).try_candidate(candidate)
