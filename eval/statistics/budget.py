"""What a soak may cost, from a TOML file, and whether it kept to it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import BeforeValidator, Field, NonNegativeFloat, NonNegativeInt, model_validator

from eval.judge.counts import Counts
from eval.judge.monitors import NAMES
from robots.strict import Strict, read_toml

BUDGET = Path(__file__).parents[1] / "budget.toml"

Share = Annotated[float, Field(ge=0, le=1)]
UNLIMITED = "unlimited"
Limit = Annotated[NonNegativeInt | None, BeforeValidator(lambda found: None if found == UNLIMITED else found)]
"""A number, or the word for none."""


class Budget(Strict):
    """Most events and least work; each monitor has exactly one line.

    Attributes:
        goal_success_min: goals reached ÷ goals due. availability_min: ticks under way ÷ ticks.
        invalid_ticks_max: ticks that nobody judged because the simulation had diverged.
        latches_max: times that a robot lost its power and waited for its operator; None for no limit.
        unlimited: monitors that are counted only.
        events_max: events in the whole run by monitor.
        events_per_hour_max: events per hour under way by monitor.
    """

    goal_success_min: Share
    availability_min: Share
    invalid_ticks_max: NonNegativeInt
    latches_max: Limit
    unlimited: tuple[str, ...]
    events_max: dict[str, NonNegativeInt]
    events_per_hour_max: dict[str, NonNegativeFloat]

    @model_validator(mode="after")
    def _each_monitor_once(self) -> Self:
        named = [*self.unlimited, *self.events_max, *self.events_per_hour_max]
        for name in named:
            if name not in NAMES:
                raise ValueError(f"unknown monitor {name!r}; known: {', '.join(NAMES)}")
            if named.count(name) > 1:
                raise ValueError(f"monitor {name!r} has {named.count(name)} lines, not one")
        missing = [name for name in NAMES if name not in named]
        if missing:
            raise ValueError(
                f"no line for {', '.join(missing)}: add to events_max, events_per_hour_max or unlimited"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One budget line against what happened.

    Attributes:
        at_least: whether `allowed` is the least allowed, not the most, which is infinite where there is no limit.
        unit: of both numbers.
    """

    name: str
    unit: str
    at_least: bool
    allowed: float
    found: float

    @property
    def passed(self) -> bool:
        """Whether the line was kept; NaN was not."""
        return self.found >= self.allowed if self.at_least else self.found <= self.allowed


def load_budget(path: Path = BUDGET) -> Budget:
    """Read a budget.

    Raises:
        ConfigError: unreadable, a key unknown or missing, a monitor unknown, twice or without a line.
    """
    return read_toml(path, Budget)


def check(budget: Budget, counts: Counts) -> list[Finding]:
    """Every budget line that concerns such a robot with what was found, work first."""
    hours, latches = counts.running_hours, budget.latches_max
    named = {monitor.name for monitor in counts.monitors}
    return [
        _line("goal_success", budget.goal_success_min, counts.goal_success, "share", at_least=True),
        _line("availability", budget.availability_min, counts.availability, "share", at_least=True),
        _line("invalid", budget.invalid_ticks_max, float(counts.invalid.sum()), "ticks"),
        _line("latches", np.inf if latches is None else latches, float(counts.latches.sum()), "times"),
        *(
            _line(name, most, counts.total(name), "events")
            for name, most in budget.events_max.items()
            if name in named
        ),
        *(
            _line(name, most, _per_hour(counts.total(name), hours), "events/h")
            for name, most in budget.events_per_hour_max.items()
            if name in named
        ),
    ]


def _line(name: str, allowed: float, found: float, unit: str, *, at_least: bool = False) -> Finding:
    return Finding(name=name, unit=unit, at_least=at_least, allowed=allowed, found=found)


def _per_hour(events: int, hours: float) -> float:
    if hours > 0:
        return events / hours
    return float("inf") if events else 0.0
