"""How packets travel: late by a time that changes, lost in bursts, twice, and after ones that were taken later.

All of it is a function of seed, robot and tick, worked out for many ticks at once: for each tick, when the packet that
arrives was taken. Nothing has to be saved.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from robots.arrays import Bools, Floats, Ints
from robots.draws import Draw
from robots.errors import ConfigError
from robots.randomness import Keys, keyed
from robots.sensors import BUFFER_S, Kind
from robots.spec import RobotSpec

CHUNK = 128
"""Ticks worked out at once, where the buffer is not longer."""
NEVER = np.iinfo(np.int64).min
"""In the place of the tick at which a packet was taken: none arrived."""
SLOW, LATE_S, BLINK_S = 10, 0.1, 0.2
"""A slow sensor sends one packet of so many; a delayed one so much later; an intermittent one is on and off so long."""
WRONG = 0.1
"""A wrong channel is off by this share of its range."""


class Failure(StrEnum):
    """Seven ways in which a sensor fails. Source: PX4 Autopilot, failure injection."""

    OFF = "off"
    STUCK = "stuck"
    GARBAGE = "garbage"
    WRONG = "wrong"
    SLOW = "slow"
    DELAYED = "delayed"
    INTERMITTENT = "intermittent"


ON_THE_WAY = (Failure.SLOW, Failure.DELAYED)
"""They happen to packets, so to all channels of a sensor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A sensor of one robot fails for a while.

    Attributes:
        robot: row. sensor: kind. what: how.
        channel: one of its channels; None for all.
        begins, ends: control ticks; it holds from the first to just before the last.
    """

    robot: int
    sensor: Kind
    what: Failure
    channel: int | None = None
    begins: int
    ends: int


class Packets:
    """When packets of B robots' G sensors arrive, in the order of `spec.sensors`.

    Attributes:
        depth: ticks of the buffer. length: ticks of a chunk: all of it arrives in that chunk or the next.
    """

    def __init__(self, spec: RobotSpec, draw: Draw, keys: Keys, faults: Sequence[Fault] = ()) -> None:
        """Take each robot's delays and losses.

        Raises:
            ConfigError: a fault of a sensor or channel that the robot lacks, or of one channel where all must fail.
        """
        sheet = list(spec.sensors.values())
        self._keys, self._dt, self._control_hz = keys, spec.dt, spec.rates.control_hz
        self._rates = np.array([sensor.rate_hz for sensor in sheet])
        delay, loss = np.array([s.delay_s for s in sheet]), np.array([s.loss for s in sheet])
        self._least, self._most = draw["sensors.delay"] * delay, draw["sensors.jitter"] * delay
        self._hold, self._repeat, self._burst = (
            draw[f"sensors.{name}"] for name in ("hold", "repeat", "burst")
        )
        self._begins = loss * draw["sensors.loss"] / self._burst
        self.robots, self.sensors = self._hold.shape
        self.depth = round(BUFFER_S / spec.dt) + 2  # one that comes again is a tick older still
        self.length = max(CHUNK, self.depth)
        self._next = NEVER  # the chunk that the tail of the last one leads into
        self._faults = [(list(spec.sensors).index(f.sensor), f) for f in _checked(faults, spec, self.robots)]

    def arriving(self, chunk: int) -> Ints:
        """(length, B, G) for each tick of a chunk, the tick at which the packet that arrives then was taken."""
        if chunk != self._next:
            self._tail = self._sent(chunk - 1, self._uniform(chunk - 1))[self.length :]
        u = self._uniform(chunk)
        sent = self._sent(chunk, u)
        arrivals = sent[: self.length]
        np.maximum(arrivals[: self.depth], self._tail, out=arrivals[: self.depth])
        self._tail, self._next = sent[self.length :], chunk + 1
        again = u[..., 4] < self._repeat
        again[0] = False
        before = np.concatenate((arrivals[:1], arrivals[:-1]))
        return np.asarray(np.where(again, before, arrivals))

    def due(self, ticks: Ints) -> Bools:
        """(T, G) whether a sensor takes a packet at each of some ticks (T,)."""
        counts = ticks[:, None] * self._rates // self._control_hz
        return np.asarray(counts != (ticks[:, None] - 1) * self._rates // self._control_hz)

    def last_taken(self, tick: int) -> Ints:
        """(B, G) the newest packet of each sensor, had it always stood still and lost nothing."""
        count = (tick - np.ceil(self._least / self._dt).astype(np.int64)) * self._rates // self._control_hz
        return np.asarray(-(-count * self._control_hz // self._rates))

    def _sent(self, chunk: int, u: Floats) -> Ints:
        """(length + depth, B, G) packets taken in a chunk, each at the tick of its arrival; the latest taken wins."""
        ticks = chunk * self.length + np.arange(self.length)
        late = np.ceil(self._delay(u) / self._dt - 1e-9).astype(np.int64)
        goes = self.due(ticks)[:, None, :] & ~self._lost(u)
        self._fail(ticks, goes, late)
        arrivals = np.full((self.length + self.depth, self.robots, self.sensors), NEVER)
        place, robot, sensor = np.nonzero(goes)
        np.maximum.at(arrivals, (place + late[goes], robot, sensor), ticks[place])
        return arrivals

    def _uniform(self, chunk: int) -> Floats:
        """(length, B, G, 5) in [0, 1)."""
        shape = (self.length, self.sensors, 5)
        return np.stack([keyed(key, chunk + 1).random(shape) for key in self._keys], axis=1)

    def _delay(self, u: Floats) -> Floats:
        """(length, B, G) s. A chunk begins with a delay of its own; after that each holds with its probability."""
        new = u[..., 0] >= self._hold
        new[0] = True
        since = np.maximum.accumulate(np.where(new, np.arange(self.length)[:, None, None], 0), axis=0)
        return np.asarray(self._least + self._most * np.take_along_axis(u[..., 1], since, axis=0))

    def _lost(self, u: Floats) -> Bools:
        """(length, B, G) Packets lost in bursts, geometric. Source: Gilbert (1960), without its good losses."""
        until = np.zeros(u.shape[:-1])
        place, robot, sensor = begins = np.nonzero(u[..., 2] < self._begins)
        with np.errstate(divide="ignore"):  # bursts of one packet: the logarithm of 0
            ends = np.log1p(-u[..., 3][begins]) / np.log1p(-1 / self._burst[robot, sensor])
        until[begins] = place + 1 + np.floor(ends)
        return np.asarray(np.maximum.accumulate(until, axis=0) > np.arange(self.length)[:, None, None])

    def _fail(self, ticks: Ints, goes: Bools, late: Ints) -> None:
        """What faults do to packets on their way."""
        for sensor, fault in self._faults:
            if fault.begins > ticks[-1] or fault.ends <= ticks[0]:
                continue
            now = (ticks >= fault.begins) & (ticks < fault.ends)
            if fault.what == Failure.SLOW:
                count = ticks * self._rates[sensor] // self._control_hz
                goes[now & (count % SLOW != 0), fault.robot, sensor] = False
            elif fault.what == Failure.DELAYED:
                late[now, fault.robot, sensor] += round(LATE_S / self._dt)
            elif fault.channel is None and fault.what in (Failure.OFF, Failure.INTERMITTENT):
                goes[silent(fault, ticks, self._dt), fault.robot, sensor] = False
        np.minimum(late, self.depth - 2, out=late)


def silent(fault: Fault, ticks: Ints, dt: float) -> Bools:
    """(T,) whether a sensor that is off, or off and on, says nothing at each of some ticks."""
    now = (ticks >= fault.begins) & (ticks < fault.ends)
    if fault.what == Failure.INTERMITTENT:
        now &= (ticks - fault.begins) // max(1, round(BLINK_S / dt)) % 2 == 0
    return np.asarray(now)


def _checked(faults: Sequence[Fault], spec: RobotSpec, robots: int) -> Sequence[Fault]:
    for fault in faults:
        known = spec.channels
        if fault.sensor not in known:
            raise ConfigError(f"{fault}: sensor {fault.sensor}: unknown; known: {', '.join(known)}")
        if not 0 <= fault.robot < robots or not 0 <= (fault.channel or 0) < known[fault.sensor]:
            raise ConfigError(f"{fault}: found {robots} robots and {known[fault.sensor]} channels")
        if fault.what in ON_THE_WAY and fault.channel is not None:
            raise ConfigError(f"{fault}: {fault.what} happens to all channels of a sensor")
    return faults
