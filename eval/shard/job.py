"""Job of a shard: everything that decides its results."""

from dataclasses import dataclass, field
from pathlib import Path

from eval.faults.schedule import FaultSettings
from eval.shard.fingerprint import code_digest

WIDTH = 16
"""Robots in a shard, of which the last shard may count fewer. Wide enough to share costs, narrow enough that 32
robots keep two cores busy."""
ARM_S = 0.2
"""s after which robots are armed for the first time: estimators need samples first."""
POLL_S = 1.0
"""s between two checks of progress, interruption and latched robots."""
OPERATOR_S = 60.0
"""s that a latched robot waits until the operator arms it again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardJob:
    """One shard's job: robot, policy, seed, ticks, faults.

    Attributes:
        robot: folder. policy: file. robot_digest, policy_digest: SHA-256 of both when the soak began.
        seed: of the soak.
        first: index of the shard's first robot. robots: number of its robots that count.
        ticks: control ticks to simulate. sample_ticks: ticks between two samples.
        faults: settings of fault injection; None for no faults.
        code_digest: SHA-256 of the code when the job was made.
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
    faults: FaultSettings | None = None
    code_digest: str = field(default_factory=code_digest)
