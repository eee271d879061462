"""Faults of simulated sensors: seven failures, as data, with their times."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from robots.arrays import Bools, Ints
from robots.errors import ConfigError
from robots.sensors import Kind
from robots.spec import RobotSpec

SLOW, LATE_S, BLINK_S = 10, 0.1, 0.2
"""A slow sensor sends one packet in `SLOW`; a delayed one `LATE_S` later; an intermittent one is off and on for
`BLINK_S` each."""
WRONG = 0.1
"""Offset of a wrong channel, as a share of its range."""


class Failure(StrEnum):
    """Seven failures of a sensor. Source: PX4 Autopilot, failure injection."""

    OFF = "off"
    STUCK = "stuck"
    GARBAGE = "garbage"
    WRONG = "wrong"
    SLOW = "slow"
    DELAYED = "delayed"
    INTERMITTENT = "intermittent"


OF_PACKETS = (Failure.SLOW, Failure.DELAYED)
"""Failures of packets, and so of all channels of a sensor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Failure of one sensor of one robot for a while.

    Attributes:
        robot: row. sensor: kind. what: failure.
        channel: one of its channels; None for all.
        begins, ends: control ticks; it holds from the first to just before the last.
    """

    robot: int
    sensor: Kind
    what: Failure
    channel: int | None = None
    begins: int
    ends: int


def silent(fault: Fault, ticks: Ints, dt: float) -> Bools:
    """Return (T,) the ticks of `ticks` (T,) in which a sensor that is off, or intermittent, sends nothing."""
    now = (ticks >= fault.begins) & (ticks < fault.ends)
    if fault.what == Failure.INTERMITTENT:
        now &= (ticks - fault.begins) // max(1, round(BLINK_S / dt)) % 2 == 0
    return np.asarray(now)


def checked(faults: Sequence[Fault], spec: RobotSpec, robots: int) -> Sequence[Fault]:
    """Refuse (ConfigError) faults of unknown sensors, robots or channels, and of one channel where all must fail."""
    for fault in faults:
        known = spec.channels
        if fault.sensor not in known:
            raise ConfigError(f"{fault}: sensor {fault.sensor}: unknown; known: {', '.join(known)}")
        if not 0 <= fault.robot < robots or not 0 <= (fault.channel or 0) < known[fault.sensor]:
            raise ConfigError(f"{fault}: found {robots} robots and {known[fault.sensor]} channels")
        if fault.what in OF_PACKETS and fault.channel is not None:
            raise ConfigError(f"{fault}: {fault.what} happens to all channels of a sensor")
    return faults
