"""A night: one finished soak, small enough to be kept for good. What pools, compares and follows nights reads this."""

import hashlib
from datetime import datetime
from typing import Annotated, Literal

from pydantic import AfterValidator

from eval.soak.profile import Faults
from eval.statistics.per_draw_counts import Tally
from robots.strict import Strict

Verdict = Literal["passed", "failed", "interrupted"]


def _moment(text: str) -> str:
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("expected a time with its zone")
    return text


class Settings(Strict):
    """On what the results depend; `workers` changes only the time it takes.

    Attributes:
        hours: h that each robot was to run.
        policy, policy_digest: the file and its SHA-256. robot, robot_digest: the name and its SHA-256.
        draws_digest: SHA-256 of the distributions that robots were drawn from. limits_digest: of the judge's limits.
        code_digest: of what ran.
        faults: on schedule; None for none.
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
    faults: Faults | None
    budget: str
    seed: int
    hours: float
    robots: int
    shard_width: int
    workers: int
    versions: dict[str, str]

    @property
    def task(self) -> dict[str, str]:
        """What is asked of what is under test, by name: nights of another task say nothing about these."""
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
        """All that must not change between nights that are evidence of one thing: not the budget, nor the seed."""
        return {
            **self.task,
            "policy_digest": self.policy_digest,
            "code_digest": self.code_digest,
            "shard_width": str(self.shard_width),
            **self.versions,
        }


class Run(Strict):
    """How it went this time.

    Attributes:
        started: ISO 8601 with zone. wall_s: s of real time since then.
        hours: h that each robot did run, on average; robots that never began count as 0.
        resumed_hours: h of these that an earlier start had left behind.
    """

    started: Annotated[str, AfterValidator(_moment)]
    wall_s: float
    hours: float
    resumed_hours: float
    interrupted: bool

    @property
    def moment(self) -> datetime:
        """`started`."""
        return datetime.fromisoformat(self.started)


class Night(Strict):
    """What is kept of a soak.

    Attributes:
        results_digest: of what was asked for, how much of it was lived and what came of it, the same however often the
            soak was taken up and however long it took.
        statement: the sentence that the soak supports.
        tally: draw by draw.
    """

    format: Literal[2]
    results_digest: str = ""
    verdict: Verdict
    statement: str
    settings: Settings
    run: Run
    tally: Tally

    def sealed(self) -> str:
        """What `results_digest` must be."""
        drawn = {"seed": str(self.settings.seed), "robots": str(self.settings.robots)}
        asked, lived = (
            sorted({**self.settings.identity, **drawn}.items()),
            (self.run.hours, self.run.interrupted),
        )
        text = f"{asked} {lived} {self.verdict} {self.statement} {self.tally.model_dump_json()}"
        return hashlib.sha256(text.encode()).hexdigest()
