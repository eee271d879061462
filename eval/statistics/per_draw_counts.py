"""Per-draw counts of a soak: the data by which soaks are pooled and policies compared."""

from collections.abc import Sequence
from itertools import chain
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS
from robots.arrays import Floats
from robots.strict import Many, Strict

COUNT_MAX = 1 << 40
"""Upper bound of a count: three times the ticks of the longest soak at 10 kHz; sums over draws stay below 2**63."""
Column = Many[Annotated[int, Field(ge=0, le=COUNT_MAX)]]
DT_MIN = 1e-6
"""s, lower bound of a control period: rates, in events per hour, are finite with any count."""
COLDEST_C, HOTTEST_C = -273.15, 1e5
"""°C, bounds of a temperature."""
Celsius = Annotated[float, Field(ge=COLDEST_C, le=HOTTEST_C)]
Ratio = tuple[Floats, Floats]
"""(R,) amounts and (R,) exposures by draw; the figure of all draws is Σ amounts ÷ Σ exposures."""


class PerDrawCounts(Strict):
    """Counts of R draws; every column has R numbers, in the order of the draws.

    Attributes:
        dt: s, the control period.
        ticks, invalid, running, stops, due, reached: as in `eval.judge.counts.Counts`.
        hard: events by hard monitor.
        hottest_c: °C, the highest true winding temperature of any joint in any tick, within its bounds;
            None where none was judged.
    """

    dt: Annotated[float, Field(ge=DT_MIN, le=1)]
    ticks: Column
    invalid: Column
    running: Column
    stops: Column
    due: Column
    reached: Column
    hard: dict[str, Column]
    hottest_c: Many[Celsius | None]

    @model_validator(mode="after")
    def _one_number_of_each_draw(self) -> Self:
        columns = {name: getattr(self, name) for name in (*_COLUMNS, "hottest_c")}
        columns |= {f"hard.{name}": column for name, column in self.hard.items()}
        for name, column in columns.items():
            if not column or len(column) != self.draws:
                raise ValueError(f"{name}: found {len(column)} numbers, expected {max(self.draws, 1)}")
        if not self.hard:
            raise ValueError("hard: found no monitor")
        return self

    @classmethod
    def from_counts(cls, counts: Counts) -> Self:
        """Return the per-draw counts of the judge's counts."""
        hottest = counts.winding_c().max(axis=1).clip(COLDEST_C, HOTTEST_C).round(2)
        hard = {
            monitor.name: tuple(counts.events[:, counts.columns(monitor.name)].sum(axis=1).tolist())
            for monitor in MONITORS
            if monitor.hard
        }
        columns = {name: tuple(getattr(counts, name).tolist()) for name in _COLUMNS}
        known = tuple(c if np.isfinite(c) else None for c in hottest.tolist())
        return cls(dt=counts.dt, hard=hard, hottest_c=known, **columns)

    @property
    def draws(self) -> int:
        """R."""
        return len(self.ticks)

    @property
    def hard_events(self) -> Ratio:
        """Events of all hard monitors, and h of operating time."""
        events = np.array([*self.hard.values()], dtype=np.float64).sum(axis=0)
        return events, np.array(self.running) * self.dt / 3600

    @property
    def goals(self) -> Ratio:
        """Goals reached, and goals due."""
        return np.array(self.reached, dtype=np.float64), np.array(self.due, dtype=np.float64)

    @property
    def availability(self) -> Ratio:
        """Ticks in operation, and all ticks."""
        return np.array(self.running, dtype=np.float64), np.array(self.ticks, dtype=np.float64)

    @property
    def bad_draws(self) -> int:
        """Draws with a hard event or a diverged simulation."""
        return int(np.sum((self.hard_events[0] > 0) | (np.array(self.invalid) > 0)))


_COLUMNS = ("ticks", "invalid", "running", "stops", "due", "reached")


def concatenate(parts: Sequence[PerDrawCounts]) -> PerDrawCounts:
    """Return the draws of one or more parts, which have the same monitors and control period."""
    joined = {
        name: tuple(chain.from_iterable(getattr(part, name) for part in parts))
        for name in (*_COLUMNS, "hottest_c")
    }
    hard = {name: tuple(chain.from_iterable(part.hard[name] for part in parts)) for name in parts[0].hard}
    return PerDrawCounts(dt=parts[0].dt, hard=hard, **joined)


def stop_ticks(*parts: PerDrawCounts) -> float | None:
    """Ticks of downtime per stop, weighted for interval estimates; None without a stop.

    Lumps of unequal size weigh as their mean square ÷ mean: twice the mean if their lengths are exponential.
    """
    stops = sum(sum(part.stops) for part in parts)
    down = sum(sum(part.ticks) - sum(part.running) for part in parts)
    return 2 * down / stops if stops else None
