"""What the judge watches, and what it found: counts by robot that shards put side by side.

A channel is one monitor on one joint, or one monitor of the whole robot; joint monitors come first, joints
within a monitor. Loads are fractions of the limit: above 1 is bad, so channels compare whatever their unit.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.state import Reason
from robots.errors import ConfigError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Monitor:
    """One thing that must not happen.

    Attributes:
        unit: of the value and its limit; empty for yes or no.
        hard: whether one event alone makes a draw of the robot a bad one.
        meaning: what is compared with what, for the reader of the report.
    """

    name: str
    unit: str
    hard: bool
    meaning: str


JOINT_MONITORS = (
    Monitor(
        name="position_requested",
        unit="rad",
        hard=False,
        meaning="the policy's target, before it is clamped, beyond the working range",
    ),
    Monitor(
        name="position_soft",
        unit="rad",
        hard=False,
        meaning="true angle nearer to the range's end than its margin",
    ),
    Monitor(name="position_hard", unit="rad", hard=True, meaning="true angle beyond the working range"),
    Monitor(name="velocity", unit="rad/s", hard=True, meaning="true joint speed"),
    Monitor(name="torque", unit="N·m", hard=True, meaning="true actuator torque at the end of its range"),
    Monitor(name="heat_soft", unit="°C", hard=False, meaning="true winding temperature, warning"),
    Monitor(name="heat_hard", unit="°C", hard=True, meaning="true winding temperature, damage"),
    Monitor(name="tracking", unit="rad", hard=False, meaning="true angle away from the angle sent"),
    Monitor(name="velocity_sent", unit="rad/s", hard=True, meaning="1st backward difference of angles sent"),
    Monitor(name="acceleration", unit="rad/s²", hard=True, meaning="2nd backward difference of angles sent"),
    Monitor(name="jerk", unit="rad/s³", hard=True, meaning="3rd backward difference of angles sent"),
)
ROBOT_MONITORS = (
    Monitor(name="self_collision", unit="", hard=True, meaning="the robot touches itself or its table"),
    Monitor(name="workspace", unit="m", hard=True, meaning="true tool position outside the workspace"),
    Monitor(name="tool_speed", unit="m/s", hard=True, meaning="true tool speed"),
)
MONITORS = JOINT_MONITORS + ROBOT_MONITORS
NAMES = tuple(monitor.name for monitor in MONITORS)
REASONS = ("NONE", *(str(reason.name) for reason in Reason))


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Consecutive bad ticks of one channel.

    Attributes:
        joint: its name, None for a monitor of the whole robot.
        start, ticks: control ticks, first bad one and from it to the last bad one, both included.
        worst: the highest load.
    """

    robot: int
    monitor: Monitor
    joint: str | None
    start: int
    ticks: int
    worst: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """R robots, C channels, the first E events of each channel.

    Attributes:
        joints: names, n of them. dt: s, the control period. goal_s: s that a goal lasts.
        limits: (C,) in the unit of the channel's monitor.
        ticks: (R,) lived through; invalid: (R,) of them with a diverged simulation, not judged;
        running, moving: (R,) of them under way, and under way with a joint in motion.
        stops: (R,) times that the robot left its work; reasons: (R, len(REASONS)) why, several may hold.
        latches: (R,) times that it lost its power, to wait for its operator.
        attempted, reached: (R,) goals, reached by ground truth.
        bad_ticks, events: (R, C); worst: (R, C) highest load, bad or not.
        log_start, log_last: (R, C, E) ticks, -1 where empty; log_worst: (R, C, E) load.
    """

    joints: tuple[str, ...]
    dt: float
    goal_s: float
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
    bad_ticks: Ints
    events: Ints
    worst: Floats
    log_start: Ints
    log_last: Ints
    log_worst: Floats

    @property
    def robots(self) -> int:
        """R, each an independent draw."""
        return len(self.ticks)

    @property
    def evaluations(self) -> int:
        """Times that every one of the monitors was asked: ticks × robots, less the invalid ones."""
        return int((self.ticks - self.invalid).sum())

    @property
    def hours(self) -> float:
        """Hours of all robots together."""
        return float(self.ticks.sum() * self.dt / 3600)

    @property
    def running_hours(self) -> float:
        """Hours armed and under way: the exposure that rates are per."""
        return float(self.running.sum() * self.dt / 3600)

    @property
    def availability(self) -> float:
        """Ticks under way ÷ ticks; 0 for none."""
        return float(self.running.sum() / max(1, self.ticks.sum()))

    @property
    def goals_due(self) -> int:
        """Goals attempted, or those that the clock allowed if a task skipped some.

        One period of grace covers arming and the goal that the end cut short.
        """
        clock = np.floor(self.ticks * self.dt / self.goal_s).astype(np.int64) - 1
        return int(np.maximum(self.attempted, clock).sum())

    @property
    def goal_success(self) -> float:
        """Goals reached ÷ goals due; 0 for none."""
        return float(self.reached.sum() / max(1, self.goals_due))

    def columns(self, monitor: str) -> slice:
        """The channels of a monitor: one a joint, or a single one."""
        k, n, many = NAMES.index(monitor), len(self.joints), len(JOINT_MONITORS)
        return slice(k * n, (k + 1) * n) if k < many else slice(many * n + k - many, many * n + k - many + 1)

    def total(self, monitor: str) -> int:
        """Events of a monitor, all robots and joints."""
        return int(self.events[:, self.columns(monitor)].sum())

    def bad_draws(self, monitor: str | None = None) -> int:
        """Robots with an event of `monitor`; without one, of any hard one, and those whose simulation diverged."""
        names = [monitor] if monitor else [m.name for m in MONITORS if m.hard]
        bad = [self.events[:, self.columns(name)].any(axis=1) for name in names]
        if monitor is None:
            bad.append(self.invalid > 0)
        return int(np.any(bad, axis=0).sum())

    def log(self) -> Iterator[Event]:
        """The kept events, by robot, channel and time."""
        n = len(self.joints)
        for robot, channel, slot in np.argwhere(self.log_start >= 0).tolist():
            of_joint = channel < len(JOINT_MONITORS) * n
            start = int(self.log_start[robot, channel, slot])
            yield Event(
                robot=robot,
                monitor=MONITORS[channel // n if of_joint else channel - len(JOINT_MONITORS) * (n - 1)],
                joint=self.joints[channel % n] if of_joint else None,
                start=start,
                ticks=int(self.log_last[robot, channel, slot]) - start + 1,
                worst=float(self.log_worst[robot, channel, slot]),
            )


_SHARED = ("joints", "dt", "goal_s", "limits")
_ROWS = tuple(field.name for field in fields(Counts) if field.name not in _SHARED)


def merge(a: Counts, b: Counts) -> Counts:
    """The robots of `a`, then those of `b`.

    Raises:
        ConfigError: they were not judged by the same limits.
    """
    for name in _SHARED:
        if not np.array_equal(getattr(a, name), getattr(b, name)):
            raise ConfigError(f"counts: {name}: {getattr(a, name)} and {getattr(b, name)} cannot be merged")
    rows: dict[str, Any] = {n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in _ROWS}
    return replace(a, **rows)


def first(counts: Counts, robots: int) -> Counts:
    """Only the first robots."""
    rows: dict[str, Any] = {name: getattr(counts, name)[:robots] for name in _ROWS}
    return replace(counts, **rows)
