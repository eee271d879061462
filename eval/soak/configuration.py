"""What a soak is asked for, the jobs that this makes, and where each keeps what it lived through."""

from dataclasses import dataclass
from pathlib import Path

from deploy.policy.policy import Policy
from eval.judge.limits import load_limits
from eval.soak.checkpoint import SUFFIX, Checkpoint
from eval.soak.fingerprint import code_digest, processor, versions
from eval.soak.profile import Faults
from eval.soak.shard import WIDTH, ShardJob
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SAMPLE_S = 60.0
"""s between two samples, in a soak long enough for `SAMPLES` of them and not too long for `SAMPLES_MAX`."""
SAMPLES, SAMPLES_MAX = 64, 1440
"""What is kept of a robot, in memory and on disk, is bounded however long it lives: a day has a sample a minute."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """What was asked for."""

    spec: RobotSpec
    policy: Policy
    policy_path: Path
    budget: Path
    hours: float
    robots: int
    seed: int
    workers: int
    faults: Faults | None = None

    @property
    def ticks(self) -> int:
        """Control ticks that each robot lives."""
        return max(1, round(self.hours * 3600 / self.spec.dt))

    @property
    def sample_ticks(self) -> int:
        """Control ticks between two samples."""
        usual = min(round(SAMPLE_S / self.spec.dt), self.ticks // SAMPLES)
        return max(1, usual, -(-self.ticks // SAMPLES_MAX))

    def drawn(self) -> Draw:
        """Every robot as it is."""
        seeds = [robot_seed(self.seed, robot) for robot in range(self.robots)]
        return draw(load_distributions(self.spec), self.spec, seeds)

    def jobs(self) -> list[ShardJob]:
        """Shards of `WIDTH` robots; the last may count fewer."""
        return [
            ShardJob(
                robot=self.spec.folder,
                policy=self.policy_path,
                robot_digest=self.spec.digest,
                policy_digest=self.policy.digest,
                seed=self.seed,
                first=start,
                robots=min(WIDTH, self.robots - start),
                ticks=self.ticks,
                sample_ticks=self.sample_ticks,
                faults=self.faults,
            )
            for start in range(0, self.robots, WIDTH)
        ]

    def checkpoint(self, number: int, folder: Path) -> Checkpoint:
        """Where the shard of job `number` is kept: everything that decides its results is in its identity."""
        identity: dict[str, str | int] = {
            "robot_digest": self.spec.digest,
            "draws_digest": load_distributions(self.spec).digest,
            "limits_digest": load_limits(self.spec).digest,
            "policy_digest": self.policy.digest,
            "code_digest": code_digest(),
            **versions(),
            "processor": processor(),
            "seed": self.seed,
            "robots": self.robots,
            "ticks": self.ticks,
            "sample_ticks": self.sample_ticks,
            "first": number * WIDTH,
            "faults": self.faults.model_dump_json() if self.faults else "none",
        }
        return Checkpoint(folder / f"shard-{number:04}{SUFFIX}", identity)
