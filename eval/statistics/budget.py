"""Budget of a soak, from a TOML file, and the check of the counts against it."""

from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import BeforeValidator, Field, NonNegativeFloat, NonNegativeInt, model_validator

from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS, NAMES
from eval.statistics.numbers import Number, Share, number
from robots.strict import Strict, read_toml

BUDGET = Path(__file__).parents[1] / "budget.toml"

UNLIMITED = "unlimited"
Limit = Annotated[NonNegativeInt | None, BeforeValidator(lambda found: None if found == UNLIMITED else found)]
"""A number, or the word "unlimited" for None."""


class Budget(Strict):
    """Upper bounds of events and lower bounds of work.

    A monitor that the file does not name has the bound of its declaration: see `Monitor.events_per_hour`.

    Attributes:
        goal_success_min: goals reached ÷ goals due. availability_min: ticks in operation ÷ all ticks.
        invalid_ticks_max: ticks that were not judged because the simulation diverged.
        latches_max: times that a robot lost its power and waited for the operator; None for no limit.
        unlimited: monitors without a limit, which are only counted.
        events_max: events in the whole soak by monitor.
        events_per_hour_max: events per hour of operating time by monitor.
    """

    goal_success_min: Share
    availability_min: Share
    invalid_ticks_max: NonNegativeInt
    latches_max: Limit
    unlimited: tuple[str, ...] = ()
    events_max: dict[str, NonNegativeInt] = Field(default_factory=dict)
    events_per_hour_max: dict[str, NonNegativeFloat] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _add_defaults(self) -> Self:
        """Check that no monitor is unknown or named twice, and add the bounds of those that are not named."""
        named = [*self.unlimited, *self.events_max, *self.events_per_hour_max]
        for name in named:
            if name not in NAMES:
                raise ValueError(f"unknown monitor {name!r}; known: {', '.join(NAMES)}")
            if named.count(name) > 1:
                raise ValueError(f"monitor {name!r} has {named.count(name)} lines, not one")
        for monitor in MONITORS:
            if monitor.name not in named and monitor.events_per_hour is not None:
                self.events_per_hour_max[monitor.name] = monitor.events_per_hour
            elif monitor.name not in named and monitor.hard:
                self.events_max[monitor.name] = 0
        return self


class BudgetLine(Strict):
    """One budget line; `about` explains `found` in words.

    `allowed` is the lower bound if `at_least`, otherwise the upper bound; None for no limit.
    """

    name: str
    unit: str
    at_least: bool
    allowed: Number
    found: Number
    passed: bool
    about: str = ""


def budget_line(
    name: str, allowed: float, found: float, unit: str, *, at_least: bool = False, about: str = ""
) -> BudgetLine:
    """Return the line of a bound, infinite for no limit, and of the value found; NaN does not pass."""
    passed = found >= allowed if at_least else found <= allowed
    numbers = {"allowed": number(allowed), "found": number(found)}
    return BudgetLine(name=name, unit=unit, at_least=at_least, **numbers, passed=passed, about=about)


def load_budget(path: Path = BUDGET) -> Budget:
    """Read a budget.

    Raises:
        ConfigError: unreadable, an unknown or missing key, a monitor unknown, listed twice or missing.
    """
    return read_toml(path, Budget)


def check(budget: Budget, counts: Counts) -> tuple[BudgetLine, ...]:
    """Compare the counts with every budget line whose monitor applies to the robot; work first."""
    latches = np.inf if budget.latches_max is None else budget.latches_max
    events = {monitor.name: counts.total(monitor.name) for monitor in counts.monitors}
    total, rate = budget.events_max.items(), budget.events_per_hour_max.items()
    return (
        budget_line("goal_success", budget.goal_success_min, counts.goal_success, "share", at_least=True),
        budget_line("availability", budget.availability_min, counts.availability, "share", at_least=True),
        budget_line("invalid", budget.invalid_ticks_max, float(counts.invalid.sum()), "ticks"),
        budget_line("latches", latches, float(counts.latches.sum()), "times"),
        *(budget_line(n, most, events[n], "events") for n, most in total if n in events),
        *(
            budget_line(n, most, _per_hour(events[n], counts.running_hours), "events/h")
            for n, most in rate
            if n in events
        ),
    )


def _per_hour(events: int, hours: float) -> float:
    if hours > 0:
        return events / hours
    return np.inf if events else 0.0
