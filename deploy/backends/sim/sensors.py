"""What the simulated bus delivers: readings that are noisy, coarse and off, in packets that are late or lost."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.packets import NEVER, WRONG, Failure, Fault, Packets, silent
from deploy.masks import all_true
from deploy.stage import Stage
from deploy.state import Packet, Sample
from robots.arrays import Bools, Floats, Ints
from robots.draws import Draw
from robots.randomness import keyed, keys
from robots.sensors import AT_JOINTS, Kind
from robots.spec import RobotSpec

NOISE, TRAVEL, GARBAGE = 1, 4, 5
"""Purposes of the streams of random numbers."""


class Sensors(Stage):
    """Every sensor of B robots: C channels side by side, in the order of `spec.sensors`.

    Attributes:
        ring: (B, depth, C) readings on their way. value: (B, C) those that arrived last. taken: (B, G) ticks when.
        told: (B, G) whether the packet that was there at a reset has been read.
        walk: (B, C) what biases have walked. cold: (B, C) °C at a reset. shift: (B, C) all constant error of a chunk.
        held: (B, C) what a stuck channel goes on saying.
    """

    carried = ("ring", "value", "taken", "told", "walk", "cold", "shift", "held", "tick")

    def __init__(
        self,
        spec: RobotSpec,
        draw: Draw,
        seeds: Sequence[np.random.SeedSequence],
        faults: Sequence[Fault] = (),
    ) -> None:
        """Read the lies that each robot's draw tells.

        Raises:
            ConfigError: a fault of a sensor that the robot lacks.
        """
        robots, sheet, sizes = len(seeds), list(spec.sensors.values()), list(spec.channels.values())
        self._dt, self._faults = spec.dt, faults
        self._noise_keys, self._garbage_keys = keys(seeds, NOISE), keys(seeds, GARBAGE)
        self._packets = Packets(spec, draw, keys(seeds, TRAVEL), faults)
        self._length = self._packets.length
        self._sensor = np.repeat(np.arange(len(sheet)), sizes)
        ends = np.cumsum(sizes)
        self.columns: dict[Kind, slice] = {
            kind: slice(end - size, end) for kind, end, size in zip(spec.sensors, ends, sizes, strict=True)
        }
        self._resolution, self._range = (
            np.tile(self._each(spec, f), (robots, 1)) for f in ("resolution", "range")
        )
        self._sigma = self._each(spec, "noise") * draw["sensors.noise"][:, self._sensor]
        self._bias = self._each(spec, "bias") * draw["sensors.bias"]
        an_hour = self._each(spec, "drift") * draw["sensors.drift"][:, self._sensor]
        self._step = an_hour * np.sqrt(self._length * self._dt / 3600)
        self._per_k = self._each(spec, "drift_per_k") * draw["sensors.drift_per_k"]
        self._housing = self._nearest_housing(spec)
        width, depth = len(self._sensor), self._packets.depth
        self.ring = np.zeros((robots, depth, width))
        self.value, self.walk, self.cold, self.shift, self.held = np.full((5, robots, width), np.nan)
        self.taken = np.zeros((robots, len(sheet)), dtype=np.int64)
        self.told, self.tick = np.zeros(self.taken.shape, dtype=bool), np.zeros(1, dtype=np.int64)
        self._noise = np.zeros((robots, self._length, width))
        self._newest = np.zeros(self.value.shape)
        self._row = np.arange(robots)[:, None] * depth
        self._chunk = NEVER
        self._t, self._fresh = np.zeros(self.taken.shape), np.zeros(self.taken.shape, dtype=bool)
        self._sample = {
            kind: Packet(t=self._t[:, g], fresh=self._fresh[:, g], value=self.value[:, columns])
            for g, (kind, columns) in enumerate(self.columns.items())
        }

    def _each(self, spec: RobotSpec, field: str) -> Floats:
        """(C,) one number of every channel's sensor."""
        return np.array([getattr(sensor, field) for sensor in spec.sensors.values()])[self._sensor]

    def _nearest_housing(self, spec: RobotSpec) -> Ints:
        """(C,) for each channel, the channel of the housing next to it: its own joint's, or the last joint's."""
        housing = np.arange(self.columns["temperature"].start, self.columns["temperature"].stop)
        parts = [
            housing if kind in AT_JOINTS else np.full(size, housing[-1])
            for kind, size in spec.channels.items()
        ]
        return np.concatenate(parts)

    def reset(self, ids: Bools, truth: Floats) -> None:
        """Robots where `ids` (B,) holds have been as `truth` (B, C) says for a while, and are read at once."""
        self.walk[ids], self.shift[ids] = 0.0, self._bias[ids]
        self.cold[ids] = truth[ids][:, self._housing]
        reading = self._quantized(truth + self.shift)
        self.ring[ids], self.value[ids], self.held[ids] = reading[ids, None, :], reading[ids], reading[ids]
        self.taken[ids], self.told[ids] = self._packets.last_taken(int(self.tick[0]))[ids], False

    def take(self, truth: Floats) -> None:
        """Move on one tick and put what is true now, (B, C), on the bus."""
        self.tick += 1
        self.told[:] = True
        tick = int(self.tick[0])
        if tick % self._length == 0:
            self._drift_on(tick // self._length, truth)
        self._need(tick // self._length)
        reading = self._quantized(truth + self._noise[:, tick % self._length] + self.shift)
        for fault in self._near:
            self._fail(fault, tick, reading)
        self.ring[:, tick % self._packets.depth] = reading

    def read(self) -> Sample:
        """The newest packet of every sensor, until the next call."""
        tick = int(self.tick[0])
        self._need(tick // self._length)
        place = tick % self._length
        arrived = self._arrived[place]
        self._fresh[:] = arrived
        if not all_true(self.told):
            self._fresh |= ~self.told
        np.copyto(self.taken, self._taken[place], where=arrived)
        self.ring.take(self._source[place], out=self._newest, mode="clip")
        np.copyto(self.value, self._newest, where=self._wide[place])
        np.multiply(self.taken, self._dt, out=self._t)
        return self._sample

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit."""
        super().restore(arrays)
        self._chunk = NEVER

    def _quantized(self, x: Floats) -> Floats:
        inside = np.minimum(np.maximum(x, -self._range), self._range)
        inside /= self._resolution
        np.rint(inside, out=inside)
        inside *= self._resolution
        return inside

    def _drift_on(self, chunk: int, truth: Floats) -> None:
        """Biases walk a step and follow the warmth."""
        for robot, key in enumerate(self._noise_keys):
            self.walk[robot] += self._step[robot] * keyed(key, 2 * chunk + 1).standard_normal(
                self.walk.shape[1]
            )
        warmed = truth[:, self._housing] - self.cold
        self.shift[:] = self._bias + self.walk + self._per_k * warmed

    def _need(self, chunk: int) -> None:
        """Make noise and arrivals of a chunk."""
        if chunk == self._chunk:
            return
        self._chunk, width = chunk, len(self._sensor)
        begin, end = chunk * self._length, (chunk + 1) * self._length
        self._near = [fault for fault in self._faults if fault.begins <= end and fault.ends > begin]
        for noise, key in zip(self._noise, self._noise_keys, strict=True):
            keyed(key, 2 * chunk).standard_normal(out=noise)
        self._noise *= self._sigma[:, None]
        arriving = self._packets.arriving(chunk)
        self._arrived = arriving != NEVER
        self._taken, self._wide = arriving, self._arrived[:, :, self._sensor]
        row = self._row + arriving % self._packets.depth
        self._source = row[:, :, self._sensor] * width + np.arange(width)

    def _fail(self, fault: Fault, tick: int, reading: Floats) -> None:
        """What a fault does to a reading; `held` is what a channel said before it got stuck."""
        columns = self.columns[fault.sensor]
        if fault.channel is not None:
            columns = slice(columns.start + fault.channel, columns.start + fault.channel + 1)
        mine, held = reading[fault.robot, columns], self.held[fault.robot, columns]
        if not fault.begins <= tick < fault.ends:
            held[:] = mine
        elif fault.what == Failure.STUCK:
            mine[:] = held
        elif fault.what == Failure.GARBAGE:
            rng = keyed(self._garbage_keys[fault.robot], tick)
            mine[:] = rng.uniform(-1.0, 1.0, mine.shape) * self._range[fault.robot, columns]
        elif fault.what == Failure.WRONG:
            mine += WRONG * self._range[fault.robot, columns]
        elif fault.channel is not None and silent(fault, np.array([tick]), self._dt)[0]:
            mine[:] = np.nan
