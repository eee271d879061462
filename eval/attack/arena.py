"""Arena: a shard in which one adversary after another is tried, each from the same beginning."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from deploy.policy.policy import Policy
from eval.attack.candidate import Candidate
from eval.attack.guards import remove_guard
from eval.attack.policy_graph import policy_file
from eval.faults.schedule import FIRST_S, LEAST_CYCLE_S, FaultSettings
from eval.replay.bundle import POLICY
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec, load_robot

EPISODE_S, FAULTY_EPISODE_S = 5.0, 10.0
"""s that a candidate is tried: long enough to throw an arm from one end of its range to the other, and for a stop with
its end. With faults, one begins in each robot after 3 to 5 s."""
FAULTS = FaultSettings(coverage=0.95, cycle_s=LEAST_CYCLE_S, operator_s=6.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What all candidates of an attack have in common.

    Attributes:
        robot: folder. mode: in which drives follow the policy. faults: one is injected into each robot.
        without: part of the description of a guard's removal (`make mutants` lists them); empty: no guard is removed.
    """

    robot: Path
    mode: ControlMode
    faults: bool = False
    without: str = ""

    @property
    def seconds(self) -> float:
        """Length of a trial, s."""
        return FAULTY_EPISODE_S if self.faults else EPISODE_S


class Outcome(NamedTuple):
    """Outcome of a trial.

    Attributes:
        worst: highest ratio of each of the robot's monitors, over all robots and joints. invalid: ticks of robots whose
            simulation diverged.
    """

    worst: dict[str, float]
    invalid: int


class Arena:
    """Shard of `WIDTH` robots of one seed.

    Attributes:
        job: of the shard, for whose policy another is tried. ticks: of a trial.
    """

    def __init__(self, setting: Setting, seed: int) -> None:
        """Build the shard, with its guard removed."""
        self.spec, self._setting = load_robot(setting.robot), setting
        self.ticks = round(setting.seconds / self.spec.dt)
        with TemporaryDirectory() as folder:
            path = Path(folder) / POLICY
            self.shard = Shard(write_job(setting, self.spec, Candidate("", {}, seed), path))
        remove_guard(setting.without, self.shard.runtime)
        self._start = self.shard.snapshot()

    def enter(self, candidate: Candidate) -> Shard:
        """Return the shard at its beginning, with the candidate's policy."""
        file = policy_file(self.spec, self._setting.mode, candidate.weights)
        self.shard.set_policy(Policy(file, candidate.adversary))
        self.shard.restore(self._start)
        return self.shard

    def trial(self, candidate: Candidate) -> Outcome:
        """Try a candidate; results depend on nothing that was tried before."""
        shard = self.enter(candidate)
        for _ in range(self.ticks):
            shard.tick()
        counts = shard.judge.counts()
        worst = {m.name: float(counts.worst[:, counts.columns(m.name)].max()) for m in counts.monitors}
        return Outcome(worst, int(counts.invalid.sum()))


def write_job(setting: Setting, spec: RobotSpec, candidate: Candidate, policy: Path) -> ShardJob:
    """Write the policy of a candidate to a file, and return the job of a shard that it moves."""
    file = policy_file(spec, setting.mode, candidate.weights)
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
        faults=FAULTS if setting.faults else None,
    )


@lru_cache(maxsize=1)
def arena(setting: Setting, seed: int) -> Arena:
    """Return the arena of a seed; the last one is kept."""
    return Arena(setting, seed)


def try_candidate(setting: Setting, candidate: Candidate) -> Outcome:
    """Try a candidate in this process."""
    return arena(setting, candidate.seed).trial(candidate)
