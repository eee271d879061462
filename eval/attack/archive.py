"""Archive of an attack: the worst candidate found for every monitor."""

from collections.abc import Sequence
from typing import NamedTuple

from eval.attack.arena import Outcome
from eval.attack.candidate import Candidate
from eval.judge.channels import Channels
from eval.judge.monitor import Monitor
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

EXEMPT = ("action_finite",)
"""Hard monitors of what the policy says itself: every policy can say what is no number."""


class Found(NamedTuple):
    """Highest ratio of a monitor, and the candidate that led to it."""

    ratio: float
    candidate: Candidate


class Archive:
    """Worst candidates by monitor; of equal ones the first is kept.

    Attributes:
        monitors: of the robot in a mode. worst: by the name of a monitor. trials: number so far.
        diverged: number of trials in which the simulation of a robot diverged.
    """

    def __init__(self, spec: RobotSpec, mode: ControlMode) -> None:
        """Start empty."""
        self.monitors: tuple[Monitor, ...] = Channels.of_robot(spec, mode=mode).monitors
        self.worst: dict[str, Found] = {}
        self.trials = self.diverged = 0

    def add(self, candidates: Sequence[Candidate], outcomes: Sequence[Outcome]) -> None:
        """Keep what is worse than before."""
        for candidate, outcome in zip(candidates, outcomes, strict=True):
            self.trials += 1
            self.diverged += outcome.invalid > 0
            for name, ratio in outcome.worst.items():
                if name not in self.worst or ratio > self.worst[name].ratio:
                    self.worst[name] = Found(ratio, candidate)

    @property
    def hard(self) -> tuple[str, ...]:
        """Names of the monitors that no policy may make report."""
        return tuple(m.name for m in self.monitors if m.hard and m.name not in EXEMPT)

    @property
    def hits(self) -> tuple[str, ...]:
        """Names of hard monitors with an event."""
        return tuple(name for name in self.hard if name in self.worst and self.worst[name].ratio > 1.0)
