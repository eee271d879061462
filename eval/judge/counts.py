"""Counts of the judge by robot: events, time, stops and goals; results of shards are merged.

Ratios are fractions of the limit. A ratio above 1 is bad, whatever the unit of the channel.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from deploy.reasons import Reason
from eval.judge.channels import Channels
from eval.judge.monitor import Monitor
from robots.arrays import Floats, Ints
from robots.errors import ConfigError

REASON_NAMES = ("NONE", *(str(reason.name) for reason in Reason))
BINS, BINS_PER_LIMIT = 201, 100
"""Histogram of ratios: bins of 0.01 of the limit; the last holds all from 2 on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Consecutive bad ticks of one channel.

    Attributes:
        joint: name; None for a monitor of the whole robot.
        start: first bad control tick. ticks: number of ticks from the first to the last bad one, both included.
        worst: highest ratio. limit: in the monitor's unit.
    """

    robot: int
    monitor: Monitor
    joint: str | None
    start: int
    ticks: int
    worst: float
    limit: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """Counts of R robots with C channels, and a log of L events, sorted by robot, channel and time.

    Attributes:
        channels: monitors and joints of the columns. dt: s, the control period. goal_s: s that a goal lasts.
        core_goals: which goals are counted apart, in words; empty for none.
        limits: (C,) in the unit of the channel's monitor; infinite where unknown, and then nothing is judged.
        ticks: (R,) simulated. invalid: (R,) of them with a diverged simulation, not judged.
        running, moving: (R,) ticks in operation, and in operation with a joint in motion.
        stops: (R,) times that the robot left operation. reasons: (R, len(REASON_NAMES)) why; several may hold.
        latches: (R,) times that the robot lost its power and waited for its operator.
        attempted, reached: (R,) goals; reached by ground truth. core_attempted, core_reached: (R,) of core goals.
        bad_ticks, events: (R, C). worst: (R, C) highest ratio, bad or not.
        bins: (C, BINS) histogram of the ratios of all robots; those of invalid ticks are in the first bin.
        log_robot, log_channel: (L,) rows and columns. log_start, log_last: (L,) ticks. log_worst: (L,) ratio.
    """

    channels: Channels
    dt: float
    goal_s: float
    core_goals: str
    limits: Floats
    ticks: Ints
    invalid: Ints
    running: Ints
    moving: Ints
    stops: Ints
    reasons: Ints
    latches: Ints
    attempted: Ints
    reached: Ints
    core_attempted: Ints
    core_reached: Ints
    bad_ticks: Ints
    events: Ints
    worst: Floats
    bins: Ints
    log_robot: Ints
    log_channel: Ints
    log_start: Ints
    log_last: Ints
    log_worst: Floats

    @property
    def robots(self) -> int:
        """R, each an independent draw."""
        return len(self.ticks)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.channels.joints

    @property
    def monitors(self) -> tuple[Monitor, ...]:
        """Monitors that the robots have."""
        return self.channels.monitors

    @property
    def evaluations(self) -> int:
        """Number of evaluations of each monitor: ticks × robots, less the invalid ones."""
        return int((self.ticks - self.invalid).sum())

    @property
    def hours(self) -> float:
        """Hours of all robots together."""
        return float(self.ticks.sum() * self.dt / 3600)

    @property
    def running_hours(self) -> float:
        """Hours in operation of all robots together: the exposure of rates."""
        return float(self.running.sum() * self.dt / 3600)

    @property
    def availability(self) -> float:
        """Ticks in operation ÷ ticks; 0 for none."""
        return float(self.running.sum() / max(1, self.ticks.sum()))

    @property
    def due(self) -> Ints:
        """(R,) goals attempted, or those that the clock allowed if a task skipped some.

        One period of grace covers arming and the goal that the end cut short.
        """
        clock = np.floor(self.ticks * self.dt / self.goal_s).astype(np.int64) - 1
        return np.asarray(np.maximum(self.attempted, clock))

    @property
    def goals_due(self) -> int:
        """Goals due of all robots together."""
        return int(self.due.sum())

    @property
    def goal_success(self) -> float:
        """Goals reached ÷ goals due; 0 for none."""
        return float(self.reached.sum() / max(1, self.goals_due))

    @property
    def core_success(self) -> float:
        """Core goals reached ÷ core goals attempted; 0 for none."""
        return float(self.core_reached.sum() / max(1, self.core_attempted.sum()))

    def columns(self, monitor: str) -> slice:
        """Return the columns of a monitor: one for each joint, or a single one."""
        return self.channels.columns(monitor)

    def winding_c(self) -> Floats:
        """(R, n) °C, the highest true temperature of each winding in any tick that was judged; NaN for none."""
        heat, judged = self.columns("heat_hard"), self.ticks > self.invalid
        return np.where(judged[:, None], self.worst[:, heat] * self.limits[heat], np.nan)

    def hard_events(self) -> Ints:
        """(R,) events of all hard monitors together."""
        hard = [self.events[:, self.columns(name)].sum(axis=1) for name in self._hard_names()]
        return np.asarray(np.sum(hard, axis=0))

    def total(self, monitor: str) -> int:
        """Return the number of events of a monitor, all robots and joints together."""
        return int(self.events[:, self.columns(monitor)].sum())

    def by_monitor(self) -> Ints:
        """(R, monitors of the catalogue) events, all joints together."""
        columns = (self.columns(monitor.name) for monitor in self.channels.catalogue)
        return np.stack([self.events[:, each].sum(axis=1) for each in columns], axis=1)

    def bad_draws(self, monitor: str | None = None) -> int:
        """Number of robots with an event of `monitor`; None: of any hard one, or with a diverged simulation."""
        names = [monitor] if monitor else self._hard_names()
        bad = [self.events[:, self.columns(name)].any(axis=1) for name in names]
        if monitor is None:
            bad.append(self.invalid > 0)
        return int(np.any(bad, axis=0).sum())

    def _hard_names(self) -> list[str]:
        return [monitor.name for monitor in self.channels.catalogue if monitor.hard]

    def left_out(self, monitor: str) -> int:
        """Return the number of events of a monitor that were counted and not logged."""
        columns = self.columns(monitor)
        logged = (self.log_channel >= columns.start) & (self.log_channel < columns.stop)
        return self.total(monitor) - int(logged.sum())

    def tail(self, share: float) -> Floats:
        """(C,) ratio exceeded in no more than a share of the ticks judged, rounded up to 0.01.

        It is never below the quantile of all ratios, at most 0.01 above it, and never above the worst; beyond the last
        bin it is the worst. NaN where nothing was judged.
        """
        below = np.cumsum(self.bins, axis=1)
        below -= self.invalid.sum()
        judged = below[:, -1:]
        place = (below < np.ceil((1 - share) * judged)).sum(axis=1)
        edge = np.where(place < BINS - 1, (place + 1) / BINS_PER_LIMIT, np.inf)
        return np.where(judged[:, 0] > 0, np.minimum(edge, self.worst.max(axis=0, initial=0.0)), np.nan)

    def log(self) -> Iterator[Event]:
        """Yield the logged events in their order."""
        for k in range(len(self.log_start)):
            channel, start = int(self.log_channel[k]), int(self.log_start[k])
            yield Event(
                robot=int(self.log_robot[k]),
                monitor=self.channels.catalogue[self.channels.monitor_index[channel]],
                joint=self.channels.joint(channel),
                start=start,
                ticks=int(self.log_last[k]) - start + 1,
                worst=float(self.log_worst[k]),
                limit=float(self.limits[channel]),
            )


_SHARED = ("channels", "dt", "goal_s", "core_goals", "limits")
_LOG = ("log_robot", "log_channel", "log_start", "log_last", "log_worst")
_ROWS = tuple(field.name for field in fields(Counts) if field.name not in (*_SHARED, *_LOG, "bins"))


def merge(a: Counts, b: Counts) -> Counts:
    """Return the counts of the robots of `a`, then those of `b`.

    Raises:
        ConfigError: they were not judged by the same limits.
    """
    for name in _SHARED:
        if not np.array_equal(getattr(a, name), getattr(b, name)):
            raise ConfigError(f"counts: {name}: {getattr(a, name)} and {getattr(b, name)} cannot be merged")
    merged: dict[str, Any] = {n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in (*_ROWS, *_LOG)}
    merged["log_robot"] = np.concatenate((a.log_robot, b.log_robot + a.robots))
    return replace(a, bins=a.bins + b.bins, **merged)
