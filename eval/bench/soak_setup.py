"""Seed, shard jobs and soaks of the benches that measure a soak."""

from pathlib import Path

from deploy.policy.policy import Policy
from eval.shard.job import WIDTH, ShardJob
from eval.soak.configuration import SoakConfig
from eval.statistics.budget import BUDGET
from robots.spec import RobotSpec

SEED = 7


def shard_job(spec: RobotSpec, policy: Path, seconds: float, *, first: int = 0) -> ShardJob:
    """Return the job of one full shard, sampled once a minute."""
    return ShardJob(
        robot=spec.folder,
        policy=policy,
        robot_digest=spec.digest,
        policy_digest=Policy.load(policy, spec).digest,
        seed=SEED,
        first=first,
        robots=WIDTH,
        ticks=round(seconds / spec.dt),
        sample_ticks=round(60 / spec.dt),
    )


def soak_config(spec: RobotSpec, policy: Path, *, hours: float, robots: int, workers: int) -> SoakConfig:
    """Return a soak by the shipped budget."""
    return SoakConfig(
        spec=spec,
        policy=Policy.load(policy, spec),
        policy_path=policy,
        budget=BUDGET,
        hours=hours,
        robots=robots,
        seed=SEED,
        workers=workers,
    )
