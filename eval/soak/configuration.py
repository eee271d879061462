"""Configuration of a soak, and the shard jobs and checkpoints that follow from it."""

import sys
from dataclasses import dataclass, field
from pathlib import Path

from deploy.policy.policy import Policy
from eval.faults.schedule import FaultSettings
from eval.history.soak_record import Settings
from eval.judge.limits import Limits, load_limits
from eval.shard.job import WIDTH, ShardJob, code_digest, processor, versions
from eval.soak.checkpoint import NAME, Checkpoint
from robots.distributions import Distributions, load_distributions
from robots.draws import Draw, draw
from robots.errors import ConfigError, printable
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SAMPLE_S = 60.0
"""s between two samples, except in a soak too short for `SAMPLES` of them or too long for `SAMPLES_MAX`."""
SAMPLES, SAMPLES_MAX = 64, 1440
"""Bounds of the number of samples of a robot, in memory and on disk; 1440 is one per minute for a day."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakConfig:
    """Options of one soak, with robot and policy loaded.

    Attributes:
        distributions, limits: of the robot's draws.toml and limits.toml when the soak began.

    Raises:
        ConfigError: draws.toml or limits.toml is invalid.
    """

    spec: RobotSpec
    policy: Policy
    policy_path: Path
    budget: Path
    hours: float
    robots: int
    seed: int
    workers: int
    faults: FaultSettings | None = None
    distributions: Distributions = field(init=False, repr=False)
    limits: Limits = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Read both files once: results say which ones they are of."""
        object.__setattr__(self, "distributions", load_distributions(self.spec))
        object.__setattr__(self, "limits", load_limits(self.spec))

    @property
    def ticks(self) -> int:
        """Control ticks of each robot."""
        return max(1, round(self.hours * 3600 / self.spec.dt))

    @property
    def sample_ticks(self) -> int:
        """Control ticks between two samples."""
        usual = min(round(SAMPLE_S / self.spec.dt), self.ticks // SAMPLES)
        return max(1, usual, -(-self.ticks // SAMPLES_MAX))

    def draw_robots(self) -> Draw:
        """Return the drawn parameters of every robot."""
        seeds = [robot_seed(self.seed, robot) for robot in range(self.robots)]
        return draw(self.distributions, self.spec, seeds)

    def draws_json(self, draw: Draw) -> str:
        """Return the text of draws.json, from which robots can be rebuilt after changes of draws.toml."""
        return draw.to_json(self.seed, self.distributions, self.spec)

    def jobs(self) -> list[ShardJob]:
        """Return jobs of `WIDTH` robots each; the last may count fewer."""
        return [
            ShardJob(
                robot=self.spec.folder,
                policy=self.policy_path,
                robot_digest=self.spec.digest,
                policy_digest=self.policy.digest,
                draws_digest=self.distributions.digest,
                limits_digest=self.limits.digest,
                seed=self.seed,
                first=start,
                robots=min(WIDTH, self.robots - start),
                ticks=self.ticks,
                sample_ticks=self.sample_ticks,
                faults=self.faults,
            )
            for start in range(0, self.robots, WIDTH)
        ]

    def settings(self) -> Settings:
        """Return the settings for record and report; paths inside the working directory are relative to it.

        Raises:
            ConfigError: the working directory was deleted.
        """
        try:
            here = Path.cwd()
        except FileNotFoundError as e:
            raise ConfigError("the working directory was deleted") from e
        policy, budget = (
            printable(str(path.resolve().relative_to(here) if path.resolve().is_relative_to(here) else path))
            for path in (self.policy_path, self.budget)
        )
        return Settings(
            command=printable(" ".join(["soak-test", *sys.argv[1:]])),
            robot=self.spec.name,
            robot_digest=self.spec.digest,
            draws_digest=self.distributions.digest,
            limits_digest=self.limits.digest,
            policy=policy,
            policy_digest=self.policy.digest,
            code_digest=code_digest(),
            faults=self.faults,
            budget=budget,
            seed=self.seed,
            hours=self.hours,
            robots=self.robots,
            shard_width=WIDTH,
            workers=self.workers,
            versions=versions(),
        )

    def checkpoint(self, number: int, folder: Path) -> Checkpoint:
        """Return the checkpoint of job `number`; its identity holds everything that decides the shard's results."""
        settings = self.settings()
        identity: dict[str, str | int] = {
            **settings.identity,
            **settings.draws,
            "processor": processor(),
            "ticks": self.ticks,
            "sample_ticks": self.sample_ticks,
            "first": number * WIDTH,
        }
        return Checkpoint(folder / NAME.format(f"{number:04}"), identity)
