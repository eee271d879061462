"""What a soak counted, draw by draw: all that nights are pooled by and policies are compared by."""

from collections.abc import Sequence
from itertools import chain
from typing import Self

import numpy as np
from pydantic import NonNegativeInt, PositiveFloat

from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS
from robots.arrays import Floats
from robots.strict import Strict

Column = tuple[NonNegativeInt, ...]
Ratio = tuple[Floats, Floats]
"""(R,) amounts and (R,) exposures, draw by draw: the sum of the former ÷ that of the latter is the figure of all."""


class Tally(Strict):
    """A column has a number for each of R draws, in their order.

    Attributes:
        dt: s, the control period.
        ticks, invalid, running, stops, due, reached: as in `eval.judge.counts.Counts`.
        hard: events by hard monitor.
        hottest_c: °C, the highest true winding temperature of any joint on any tick; None where none was judged.
    """

    dt: PositiveFloat
    ticks: Column
    invalid: Column
    running: Column
    stops: Column
    due: Column
    reached: Column
    hard: dict[str, Column]
    hottest_c: tuple[float | None, ...]

    @classmethod
    def of(cls, counts: Counts) -> Self:
        """Of what the judge found."""
        hottest = counts.winding_c().max(axis=1).round(2)
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
        """Events of all hard monitors, and h under way."""
        events = np.array([*self.hard.values()], dtype=np.float64).sum(axis=0)
        return events, np.array(self.running) * self.dt / 3600

    @property
    def goals(self) -> Ratio:
        """Goals reached, and due."""
        return np.array(self.reached, dtype=np.float64), np.array(self.due, dtype=np.float64)

    @property
    def under_way(self) -> Ratio:
        """Ticks under way, and all."""
        return np.array(self.running, dtype=np.float64), np.array(self.ticks, dtype=np.float64)

    @property
    def bad_draws(self) -> int:
        """Draws with a hard event, and those whose simulation diverged."""
        return int(np.sum((self.hard_events[0] > 0) | (np.array(self.invalid) > 0)))


_COLUMNS = ("ticks", "invalid", "running", "stops", "due", "reached")


def together(tallies: Sequence[Tally]) -> Tally:
    """The draws of all of them, in order; one or more, of the same monitors and control period."""
    joined = {
        name: tuple(chain.from_iterable(getattr(t, name) for t in tallies))
        for name in (*_COLUMNS, "hottest_c")
    }
    hard = {name: tuple(chain.from_iterable(t.hard[name] for t in tallies)) for name in tallies[0].hard}
    return Tally(dt=tallies[0].dt, hard=hard, **joined)


def stop_ticks(*tallies: Tally) -> float | None:
    """Ticks that one stop takes out of the work, as interval estimates are to weigh it; None if none was seen.

    Lumps of unequal size weigh as their mean square ÷ mean: twice the mean if their lengths are exponential.
    """
    stops = sum(sum(t.stops) for t in tallies)
    down = sum(sum(t.ticks) - sum(t.running) for t in tallies)
    return 2 * down / stops if stops else None
