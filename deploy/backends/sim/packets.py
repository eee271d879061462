"""Packets of simulated sensors: variable delay, loss in bursts, repetition, reordering.

All of it is a function of the robots' streams and the tick, computed in chunks of ticks: for each tick, when the packet
that arrives was sampled. Nothing has to be saved but the keys of the streams.
"""

from collections.abc import Sequence

import numpy as np

from deploy.backends.sim.sensor_faults import LATE_S, SLOW, Failure, Fault, checked, silent
from robots.arrays import Bools, Floats, Ints
from robots.draws import Draw
from robots.randomness import Keys, generator_at
from robots.sensors import BUFFER_S
from robots.spec import RobotSpec

CHUNK = 128
"""Ticks computed at once, unless the buffer is longer."""
NEVER = np.iinfo(np.int64).min
"""In place of the tick at which a packet was sampled: none arrived."""


class Packets:
    """Arrival of the packets of B robots' G sensors, in the order of `spec.sensors`.

    Attributes:
        depth: ticks of the buffer. length: ticks of a chunk: all of it arrives in that chunk or the next.
    """

    def __init__(self, spec: RobotSpec, draw: Draw, keys: Keys, faults: Sequence[Fault] = ()) -> None:
        """Take each robot's delays and losses, and B streams of random numbers.

        Raises:
            ConfigError: a fault of a sensor or channel that the robot lacks, or of one channel where all must fail.
        """
        sheet = list(spec.sensors.values())
        self._keys, self._dt, self._control_hz = keys, spec.dt, spec.rates.control_hz
        self._rates = np.array([sensor.rate_hz for sensor in sheet])
        delay, loss = np.array([s.delay_s for s in sheet]), np.array([s.loss for s in sheet])
        self._delay_min, self._jitter = draw["sensors.delay"] * delay, draw["sensors.jitter"] * delay
        self._hold, self._repeat, self._burst = (
            draw[f"sensors.{name}"] for name in ("hold", "repeat", "burst")
        )
        self._burst_begins = loss * draw["sensors.loss"] / self._burst
        self.robots, self.sensors = self._hold.shape
        self.depth = round(BUFFER_S / spec.dt) + 2  # a repeated packet is a tick older still
        self.length = max(CHUNK, self.depth)
        self._next = NEVER  # the chunk that the tail of the last one leads into
        self._faults = [(list(spec.sensors).index(f.sensor), f) for f in checked(faults, spec, self.robots)]

    def use(self, keys: Keys) -> None:
        """Take other streams, for all ticks."""
        self._keys, self._next = keys, NEVER

    def arriving(self, chunk: int) -> Ints:
        """Return (length, B, G) for each tick of a chunk the tick at which the packet that arrives was sampled."""
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
        """Return (T, G) the sensors that sample at each of `ticks` (T,)."""
        counts = ticks[:, None] * self._rates // self._control_hz
        return np.asarray(counts != (ticks[:, None] - 1) * self._rates // self._control_hz)

    def last_sampled(self, tick: int) -> Ints:
        """Return (B, G) the tick of each sensor's newest packet, without jitter and losses."""
        count = (
            (tick - np.ceil(self._delay_min / self._dt).astype(np.int64)) * self._rates // self._control_hz
        )
        return np.asarray(-(-count * self._control_hz // self._rates))

    def _sent(self, chunk: int, u: Floats) -> Ints:
        """Return (length + depth, B, G) packets sampled in a chunk, at the tick of their arrival; the newest wins."""
        ticks = chunk * self.length + np.arange(self.length)
        late = np.ceil(self._delay(u) / self._dt - 1e-9).astype(np.int64)
        goes = self.due(ticks)[:, None, :] & ~self._lost(u)
        self._fail(ticks, goes, late)
        arrivals = np.full((self.length + self.depth, self.robots, self.sensors), NEVER)
        place, robot, sensor = np.nonzero(goes)
        np.maximum.at(arrivals, (place + late[goes], robot, sensor), ticks[place])
        return arrivals

    def _uniform(self, chunk: int) -> Floats:
        """Return (length, B, G, 5) in [0, 1)."""
        shape = (self.length, self.sensors, 5)
        return np.stack([generator_at(key, chunk + 1).random(shape) for key in self._keys], axis=1)

    def _delay(self, u: Floats) -> Floats:
        """Return (length, B, G) s. A chunk begins with a new delay; after that each holds with its probability."""
        new = u[..., 0] >= self._hold
        new[0] = True
        since = np.maximum.accumulate(np.where(new, np.arange(self.length)[:, None, None], 0), axis=0)
        return np.asarray(self._delay_min + self._jitter * np.take_along_axis(u[..., 1], since, axis=0))

    def _lost(self, u: Floats) -> Bools:
        """Return (length, B, G) losses in geometric bursts. Source: Gilbert (1960), without its good losses."""
        until = np.zeros(u.shape[:-1])
        place, robot, sensor = begins = np.nonzero(u[..., 2] < self._burst_begins)
        with np.errstate(divide="ignore"):  # bursts of one packet: the logarithm of 0
            ends = np.log1p(-u[..., 3][begins]) / np.log1p(-1 / self._burst[robot, sensor])
        until[begins] = place + 1 + np.floor(ends)
        return np.asarray(np.maximum.accumulate(until, axis=0) > np.arange(self.length)[:, None, None])

    def _fail(self, ticks: Ints, goes: Bools, late: Ints) -> None:
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
