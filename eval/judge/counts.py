"""What the judge watches, and what it found: counts by robot that shards put side by side.

A channel is one monitor on one joint, or one monitor of the whole robot; joint monitors come first, joints
within a monitor. Loads are fractions of the limit: above 1 is bad, so channels compare whatever their unit.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from deploy.state import Reason
from robots.arrays import Floats, Ints
from robots.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class Monitor:
    """One thing that must not happen.

    Attributes:
        unit: of the value and its limit; empty for yes or no, 1 for a plain number.
        hard: whether one event alone makes a draw of the robot a bad one.
        meaning: what is compared with what, for the reader of the report.
        base: whether only a robot with a base has it, or only one that stands fixed; None: every robot.
    """

    name: str
    unit: str
    hard: bool
    meaning: str
    base: bool | None = None


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
    Monitor(name="power", unit="W", hard=False, meaning="true mechanical power of a joint, given or taken"),
    Monitor(name="heat_soft", unit="°C", hard=False, meaning="true winding temperature, warning"),
    Monitor(name="heat_hard", unit="°C", hard=True, meaning="true winding temperature, damage"),
    Monitor(name="tracking", unit="rad", hard=False, meaning="true angle away from the angle sent"),
    Monitor(
        name="estimate",
        unit="1",
        hard=False,
        meaning="squared error of the estimated angle, in variances that the estimator claims",
    ),
    Monitor(
        name="torque_rate",
        unit="N·m/s",
        hard=True,
        meaning="1st backward difference of the feed-forward torques sent",
    ),
    Monitor(
        name="command_jump",
        unit="rad",
        hard=True,
        meaning="angle sent in the first tick of power, away from the true one by more than is allowed for arming, and"
        " in the second, away from the first, by more than full acceleration from rest",
    ),
    Monitor(name="velocity_sent", unit="rad/s", hard=True, meaning="1st backward difference of angles sent"),
    Monitor(name="acceleration", unit="rad/s²", hard=True, meaning="2nd backward difference of angles sent"),
    Monitor(name="jerk", unit="rad/s³", hard=True, meaning="3rd backward difference of angles sent"),
)
ROBOT_MONITORS = (
    Monitor(name="self_collision", unit="", hard=True, meaning="the robot touches itself or its table"),
    Monitor(name="contact_force", unit="N", hard=True, meaning="true normal force of the strongest contact"),
    Monitor(
        name="workspace",
        unit="m",
        hard=True,
        meaning="true tool position outside the workspace",
        base=False,
    ),
    Monitor(
        name="singularity",
        unit="1/m³",
        hard=False,
        meaning="1 ÷ manipulability (Yoshikawa) at the true angles; in a singularity and beyond it 1000 × its limit",
        base=False,
    ),
    Monitor(name="tool_speed", unit="m/s", hard=True, meaning="true tool speed", base=False),
    Monitor(
        name="tilt", unit="rad", hard=True, meaning="true tilt of a base: it falls, or has fallen", base=True
    ),
    Monitor(
        name="fallen",
        unit="rad",
        hard=True,
        meaning="true tilt of a base whose robot is still under way, by more than a stop needs to begin",
        base=True,
    ),
    Monitor(name="robot_power", unit="W", hard=False, meaning="true mechanical power of all joints together"),
    Monitor(
        name="observation",
        unit="1",
        hard=False,
        meaning="number of an observation furthest off what training saw, in its standard deviations, under way",
    ),
    Monitor(
        name="action_finite", unit="", hard=True, meaning="under way a tick after the policy said NaN or inf"
    ),
)
MONITORS = JOINT_MONITORS + ROBOT_MONITORS
NAMES = tuple(monitor.name for monitor in MONITORS)
REASONS = ("NONE", *(str(reason.name) for reason in Reason))
BINS, PER_LOAD = 201, 100
"""Loads are counted in bins of 0.01 of the limit, of which the last holds all from 2 on."""


def monitor_of(joints: int) -> Ints:
    """(C,) the number of each channel's monitor, for a robot of so many joints."""
    of_joints = np.repeat(np.arange(len(JOINT_MONITORS)), joints)
    return np.concatenate((of_joints, np.arange(len(JOINT_MONITORS), len(MONITORS))))


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Consecutive bad ticks of one channel.

    Attributes:
        joint: its name, None for a monitor of the whole robot.
        start, ticks: control ticks, first bad one and from it to the last bad one, both included.
        worst: the highest load. limit: what it is a fraction of, in the monitor's unit.
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
    """R robots, C channels, L events kept one by one, by robots, channels and time.

    Attributes:
        joints: names, n of them. dt: s, the control period. goal_s: s that a goal lasts.
        limits: (C,) in the unit of the channel's monitor; infinite where nothing says it, and nothing is judged.
        ticks: (R,) lived through; invalid: (R,) of them with a diverged simulation, not judged;
        running, moving: (R,) of them under way, and under way with a joint in motion.
        stops: (R,) times that the robot left its work; reasons: (R, len(REASONS)) why, several may hold.
        latches: (R,) times that it lost its power, to wait for its operator.
        attempted, reached: (R,) goals, reached by ground truth.
        bad_ticks, events: (R, C); worst: (R, C) highest load, bad or not.
        bins: (C, BINS) ticks of all robots by load; invalid ones lie in the first. All 0 where it is not known.
        log_robot, log_channel: (L,) rows and channels; log_start, log_last: (L,) ticks; log_worst: (L,) load.
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
    def monitors(self) -> tuple[Monitor, ...]:
        """Those that concern such a robot, of which one with a base has a limit of tilt."""
        walks = bool(np.isfinite(self.limits[self.columns("tilt")]).all())
        return tuple(monitor for monitor in MONITORS if monitor.base in (None, walks))

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

    def columns(self, monitor: str) -> slice:
        """The channels of a monitor: one a joint, or a single one."""
        k, n, many = NAMES.index(monitor), len(self.joints), len(JOINT_MONITORS)
        return slice(k * n, (k + 1) * n) if k < many else slice(many * n + k - many, many * n + k - many + 1)

    def winding_c(self) -> Floats:
        """(R, n) °C, the highest true temperature of each winding on any tick that was judged; NaN for none."""
        heat, judged = self.columns("heat_hard"), self.ticks > self.invalid
        return np.where(judged[:, None], self.worst[:, heat] * self.limits[heat], np.nan)

    def hard_events(self) -> Ints:
        """(R,) events of hard monitors, all of them and all joints together."""
        hard = [self.events[:, self.columns(m.name)].sum(axis=1) for m in MONITORS if m.hard]
        return np.asarray(np.sum(hard, axis=0))

    def total(self, monitor: str) -> int:
        """Events of a monitor, all robots and joints."""
        return int(self.events[:, self.columns(monitor)].sum())

    def by_monitor(self) -> Ints:
        """(R, monitors) events, all joints together."""
        return np.stack([self.events[:, self.columns(name)].sum(axis=1) for name in NAMES], axis=1)

    def bad_draws(self, monitor: str | None = None) -> int:
        """Robots with an event of `monitor`; without one, of any hard one, and those whose simulation diverged."""
        names = [monitor] if monitor else [m.name for m in MONITORS if m.hard]
        bad = [self.events[:, self.columns(name)].any(axis=1) for name in names]
        if monitor is None:
            bad.append(self.invalid > 0)
        return int(np.any(bad, axis=0).sum())

    def left_out(self, monitor: str) -> int:
        """Events of a monitor that were counted and not kept one by one."""
        columns = self.columns(monitor)
        kept = (self.log_channel >= columns.start) & (self.log_channel < columns.stop)
        return self.total(monitor) - int(kept.sum())

    def tail(self, share: float) -> Floats:
        """(C,) the load that a channel stayed below in all but a share of the ticks judged, rounded up to 0.01.

        Never below the quantile of all loads and at most so much above it, never above the worst; beyond the last bin
        it is the worst. NaN where nothing was judged.
        """
        below = np.cumsum(self.bins, axis=1)
        below -= self.invalid.sum()
        many = below[:, -1:]
        place = (below < np.ceil((1 - share) * many)).sum(axis=1)
        edge = np.where(place < BINS - 1, (place + 1) / PER_LOAD, np.inf)
        return np.where(many[:, 0] > 0, np.minimum(edge, self.worst.max(axis=0, initial=0.0)), np.nan)

    def log(self) -> Iterator[Event]:
        """The events that were kept, in their order."""
        monitors, n = monitor_of(len(self.joints)), len(self.joints)
        of_joints = len(JOINT_MONITORS) * n
        for k in range(len(self.log_start)):
            channel, start = int(self.log_channel[k]), int(self.log_start[k])
            yield Event(
                robot=int(self.log_robot[k]),
                monitor=MONITORS[monitors[channel]],
                joint=self.joints[channel % n] if channel < of_joints else None,
                start=start,
                ticks=int(self.log_last[k]) - start + 1,
                worst=float(self.log_worst[k]),
                limit=float(self.limits[channel]),
            )


_SHARED = ("joints", "dt", "goal_s", "limits")
_LOG = ("log_robot", "log_channel", "log_start", "log_last", "log_worst")
_ROWS = tuple(field.name for field in fields(Counts) if field.name not in (*_SHARED, *_LOG, "bins"))


def merge(a: Counts, b: Counts) -> Counts:
    """The robots of `a`, then those of `b`.

    Raises:
        ConfigError: they were not judged by the same limits.
    """
    for name in _SHARED:
        if not np.array_equal(getattr(a, name), getattr(b, name)):
            raise ConfigError(f"counts: {name}: {getattr(a, name)} and {getattr(b, name)} cannot be merged")
    together: dict[str, Any] = {n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in (*_ROWS, *_LOG)}
    together["log_robot"] = np.concatenate((a.log_robot, b.log_robot + a.robots))
    return replace(a, bins=a.bins + b.bins, **together)
