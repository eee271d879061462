"""Archive of an attack: the worst candidate found for every monitor."""

from typing import NamedTuple

from eval.attack.adversaries import OF_MANY
from eval.attack.arena import Outcome
from eval.attack.candidate import Block, Candidate
from eval.judge.channels import Channels
from eval.judge.monitor import Monitor
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

EXEMPT = ("action_finite", "tilt", "base_height")
"""Hard monitors of what the policy decides itself: it can say what is no number, and let a robot fall."""
MOVED = 1e-3
"""Difference of a monitor's ratios that a search can follow. What every policy brings to its limit has less."""


class Found(NamedTuple):
    """Highest ratio of a monitor, and the candidate that led to it."""

    ratio: float
    candidate: Candidate


class Archive:
    """Worst candidates by monitor; of equal ones the first is kept.

    Attributes:
        monitors: of the robot in a mode. hard: names of those that no policy may make report.
        worst: by the names of the monitors. worst_of_many: the same without those of pushed arms.
        least: lowest ratio of any trial, likewise.
        trials: number of policies tried. diverged: number of them whose simulation diverged.
    """

    def __init__(self, spec: RobotSpec, mode: ControlMode) -> None:
        """Start empty."""
        self.monitors: tuple[Monitor, ...] = Channels.of_robot(spec, mode=mode).monitors
        self.hard = tuple(m.name for m in self.monitors if m.hard and m.name not in EXEMPT)
        self.worst: dict[str, Found] = {}
        self.worst_of_many: dict[str, Found] = {}
        self.least: dict[str, float] = {}
        self.trials = self.diverged = 0

    def add(self, block: Block, outcome: Outcome) -> None:
        """Keep what is worse than before."""
        self.trials += len(block.rows)
        self.diverged += int(outcome.diverged.sum())
        for name, ratios in outcome.worst.items():
            robot = int(ratios.argmax())
            found = Found(float(ratios[robot]), block.candidate(robot))
            for worst in (self.worst, *([self.worst_of_many] if block.adversary in OF_MANY else [])):
                if name not in worst or found.ratio > worst[name].ratio:
                    worst[name] = found
            self.least[name] = min(float(ratios.min()), self.least.get(name, found.ratio))

    def moved(self, name: str) -> bool:
        """Return True if some policies brought a monitor closer to its limit than others."""
        return self.worst[name].ratio - self.least[name] > MOVED

    @property
    def hits(self) -> tuple[str, ...]:
        """Names of hard monitors with an event."""
        return tuple(name for name in self.hard if name in self.worst and self.worst[name].ratio > 1.0)
