"""Record of one finished soak, small enough to be kept for good; pooling, comparison and trend read it."""

import hashlib
from datetime import datetime
from typing import Annotated, Literal

from pydantic import AfterValidator

from eval.faults.schedule import FaultSettings
from eval.statistics.per_draw_counts import PerDrawCounts
from robots.strict import Strict

Verdict = Literal["passed", "failed", "interrupted"]


def _time_with_zone(text: str) -> str:
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError("expected a time with its zone")
    if text != moment.isoformat():  # fromisoformat takes any letter, also Esc, between date, time and zone
        raise ValueError(f"expected {moment.isoformat()}")
    return text


class Settings(Strict):
    """Settings that the results depend on; `workers` changes only the duration.

    Attributes:
        hours: h to simulate for each robot.
        policy, policy_digest: the file and its SHA-256. robot, robot_digest: the name and its SHA-256.
        draws_digest: SHA-256 of the distributions of robot parameters. limits_digest: SHA-256 of the judge's limits.
        code_digest: SHA-256 of the code.
        faults: settings of fault injection; None for no faults.
        budget: the file. versions: of Python and of the libraries, by name.
    """

    command: str
    robot: str
    robot_digest: str
    draws_digest: str
    limits_digest: str
    policy: str
    policy_digest: str
    code_digest: str
    faults: FaultSettings | None
    budget: str
    seed: int
    hours: float
    robots: int
    shard_width: int
    workers: int
    versions: dict[str, str]

    @property
    def task(self) -> dict[str, str]:
        """Robot, limits, hours and faults by name; soaks with different tasks cannot be compared."""
        return {
            "robot": self.robot,
            "robot_digest": self.robot_digest,
            "draws_digest": self.draws_digest,
            "limits_digest": self.limits_digest,
            "hours": f"{self.hours:g}",
            "faults": self.faults.model_dump_json() if self.faults else "none",
        }

    @property
    def identity(self) -> dict[str, str]:
        """Everything that must be equal in soaks that are pooled: neither budget nor seed."""
        return {
            **self.task,
            "policy_digest": self.policy_digest,
            "code_digest": self.code_digest,
            "shard_width": str(self.shard_width),
            **self.versions,
        }

    @property
    def draws(self) -> dict[str, str]:
        """Seed and number of robots, which choose the draws."""
        return {"seed": str(self.seed), "robots": str(self.robots)}


class Run(Strict):
    """Time and extent of one run.

    Attributes:
        started: ISO 8601 with zone. wall_s: s of real time since then.
        hours: h simulated for each robot, on average; robots that were not started count as 0.
        resumed_hours: h of these that came from the checkpoints of an earlier start.
    """

    started: Annotated[str, AfterValidator(_time_with_zone)]
    wall_s: float
    hours: float
    resumed_hours: float
    interrupted: bool

    @property
    def moment(self) -> datetime:
        """`started` as a datetime."""
        return datetime.fromisoformat(self.started)


class SoakRecord(Strict):
    """Settings, verdict and per-draw counts of one soak.

    Attributes:
        results_digest: SHA-256 of settings, simulated hours and results; it does not depend on how often the soak was
            resumed or how long it took.
        statement: the sentence that the results support.
        per_draw_counts: counts of every draw.
    """

    format: Literal[2]
    results_digest: str = ""
    verdict: Verdict
    statement: str
    settings: Settings
    run: Run
    per_draw_counts: PerDrawCounts

    def sealed(self) -> str:
        """Return the correct value of `results_digest`."""
        settings = sorted({**self.settings.identity, **self.settings.draws}.items())
        extent = self.run.hours, self.run.interrupted
        counts = self.per_draw_counts.model_dump_json()
        text = f"{settings} {extent} {self.verdict} {self.statement} {counts}"
        return hashlib.sha256(text.encode()).hexdigest()
