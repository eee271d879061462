"""Simulated sensors: noise, bias and drift, resolution, in packets that are late or lost."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.packets import NEVER, Packets
from deploy.backends.sim.sensor_faults import WRONG, Failure, Fault, silent
from deploy.masks import all_true
from deploy.stage import Stage
from deploy.state import Packet, Sample
from robots.arrays import Bools, Floats, Ints
from robots.draws import Draw
from robots.randomness import Keys, Stream, generator_at, stream_keys
from robots.sensors import KINDS, Kind
from robots.spec import RobotSpec


class Sensors(Stage):
    """Every sensor of B robots: C channels side by side, in the order of `spec.sensors`; G sensors.

    Attributes:
        columns: channels of each kind of sensor.
        noise_keys: B streams of noise; the readings of a wait have their own. packet_keys: (B, 2) of packets.
        ring: (B, depth, C) readings in transit. value: (B, C) those that arrived last. sampled: (B, G) their ticks.
        seen: (B, G) False until the packet of a reset has been read.
        bias_walk: (B, C) random walk of the biases. cold: (B, C) °C at a reset.
        offset: (B, C) constant error of a chunk.
        held: (B, C) value of a stuck channel.
    """

    carried = (
        *("ring", "value", "sampled", "seen", "bias_walk"),
        *("cold", "offset", "held", "tick", "packet_keys"),
    )

    def __init__(
        self,
        spec: RobotSpec,
        draw: Draw,
        seeds: Sequence[np.random.SeedSequence],
        faults: Sequence[Fault] = (),
    ) -> None:
        """Read each robot's errors from its draw.

        Raises:
            ConfigError: a fault of a sensor that the robot lacks.
        """
        robots, sheet, sizes = len(seeds), list(spec.sensors.values()), list(spec.channels.values())
        self._dt, self._faults = spec.dt, faults
        self.noise_keys = stream_keys(seeds, Stream.SENSOR_NOISE)
        self._wait_keys = stream_keys(seeds, Stream.WAIT_NOISE)
        self._garbage_keys = stream_keys(seeds, Stream.SENSOR_GARBAGE)
        self.packet_keys = stream_keys(seeds, Stream.PACKETS)
        self._packets = Packets(spec, draw, self.packet_keys, faults)
        self._length = self._packets.length
        self._sensor = np.repeat(np.arange(len(sheet)), sizes)
        ends = np.cumsum(sizes)
        self.columns: dict[Kind, slice] = {
            kind: slice(end - size, end) for kind, end, size in zip(spec.sensors, ends, sizes, strict=True)
        }
        self._read_errors(spec, draw)
        self._allocate(robots, len(sheet))

    def _read_errors(self, spec: RobotSpec, draw: Draw) -> None:
        robots = len(self.noise_keys)
        self._resolution, self._range = (
            np.tile(self._each(spec, f), (robots, 1)) for f in ("resolution", "range")
        )
        self._most = self._range.copy()
        counts_turns = np.isinf(spec.joint_array("q_max"))
        self._most[:, self.columns["encoder"]][:, counts_turns] = np.inf
        self._sigma = self._each(spec, "noise") * draw["sensors.noise"][:, self._sensor]
        self._bias = self._each(spec, "bias") * draw["sensors.bias"]
        drift_per_hour = self._each(spec, "drift") * draw["sensors.drift"][:, self._sensor]
        self._walk_step = drift_per_hour * np.sqrt(self._length * self._dt / 3600)
        self._per_k = self._each(spec, "drift_per_k") * draw["sensors.drift_per_k"]
        self._housing = self._nearest_housing(spec)

    def _allocate(self, robots: int, sensors: int) -> None:
        width, depth = len(self._sensor), self._packets.depth
        self.ring = np.zeros((robots, depth, width))
        self.value, self.bias_walk, self.cold, self.offset, self.held = np.full((5, robots, width), np.nan)
        self.sampled = np.zeros((robots, sensors), dtype=np.int64)
        self.seen, self.tick = np.zeros(self.sampled.shape, dtype=bool), np.zeros(1, dtype=np.int64)
        self._noise = np.zeros((robots, self._length, width))
        self._newest = np.zeros(self.value.shape)
        self._row = np.arange(robots)[:, None] * depth
        self._chunk = NEVER
        self._t, self._fresh = np.zeros(self.sampled.shape), np.zeros(self.sampled.shape, dtype=bool)
        self._sample = {
            kind: Packet(t=self._t[:, g], fresh=self._fresh[:, g], value=self.value[:, columns])
            for g, (kind, columns) in enumerate(self.columns.items())
        }

    def _each(self, spec: RobotSpec, field: str) -> Floats:
        return np.array([getattr(sensor, field) for sensor in spec.sensors.values()])[self._sensor]

    def _nearest_housing(self, spec: RobotSpec) -> Ints:
        """Return (C,) for each channel that of the nearest housing: its own joint's, or the last joint's."""
        housing = np.arange(self.columns["temperature"].start, self.columns["temperature"].stop)
        parts = [
            housing if KINDS[kind].at == "joints" else np.full(size, housing[-1])
            for kind, size in spec.channels.items()
        ]
        return np.concatenate(parts)

    def reset(self, ids: Bools, truth: Floats) -> None:
        """Reset robots where `ids` (B,) holds, as if `truth` (B, C) had been there for a while; it is read at once."""
        self.bias_walk[ids], self.offset[ids] = 0.0, self._bias[ids]
        self.cold[ids] = truth[ids][:, self._housing]
        reading = self._quantized(truth + self.offset)
        self.ring[ids], self.value[ids], self.held[ids] = reading[ids, None, :], reading[ids], reading[ids]
        self.sampled[ids], self.seen[ids] = self._packets.last_sampled(int(self.tick[0]))[ids], False

    def sample(self, truth: Floats) -> None:
        """Advance one tick and put readings of `truth` (B, C) on the bus."""
        self.tick += 1
        self.seen[:] = True
        tick = int(self.tick[0])
        if tick % self._length == 0:
            self._step_biases(tick // self._length, truth)
        self._prepare(tick // self._length)
        reading = self._quantized(truth + self._noise[:, tick % self._length] + self.offset)
        for fault in self._faults_of_chunk:
            self._fail(fault, tick, reading)
        self.ring[:, tick % self._packets.depth] = reading

    def noise_of_wait(self, robot: int, periods: int) -> Floats:
        """Return noise (periods, C) of the readings that one robot takes before the computer's late tick."""
        rng = generator_at(self._wait_keys[robot], int(self.tick[0]))
        return np.asarray(rng.standard_normal((periods, self.ring.shape[2])) * self._sigma[robot])

    def wait(self, robot: int, truth: Floats, noise: Floats) -> None:
        """Put a reading of `truth` (B, C), with noise (C,), on the bus of one robot, whose computer is late.

        The runtime's clock stands still meanwhile: all readings of before become a period older.
        """
        tick, ring = int(self.tick[0]), self.ring[robot]
        self._prepare(tick // self._length)
        reading = self._quantized(truth + noise + self.offset)
        for fault in self._faults_of_chunk:
            if fault.robot == robot:
                self._fail(fault, tick, reading)
        newest_first = (tick - np.arange(len(ring))) % len(ring)
        ring[newest_first[1:]] = ring[newest_first[:-1]]
        ring[newest_first[0]] = reading[robot]

    def read(self) -> Sample:
        """Return the newest packet of every sensor; valid until the next call."""
        tick = int(self.tick[0])
        self._prepare(tick // self._length)
        place = tick % self._length
        arrived = self._arrived[place]
        self._fresh[:] = arrived
        if not all_true(self.seen):
            self._fresh |= ~self.seen
        np.copyto(self.sampled, self._arrivals[place], where=arrived)
        self.ring.take(self._source[place], out=self._newest, mode="clip")
        np.copyto(self.value, self._newest, where=self._arrived_channels[place])
        np.multiply(self.sampled, self._dt, out=self._t)
        return self._sample

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore saved arrays, bit for bit."""
        super().restore(arrays)
        self.use_packets(self.packet_keys)

    def use_packets(self, keys: Keys) -> None:
        """Take the packets of other streams (B, 2), for all ticks."""
        self.packet_keys[:] = keys
        self._packets.use(self.packet_keys)
        self._chunk = NEVER

    def _quantized(self, x: Floats) -> Floats:
        inside = np.minimum(np.maximum(x, -self._most), self._most)
        inside /= self._resolution
        np.rint(inside, out=inside)
        inside *= self._resolution
        return inside

    def _step_biases(self, chunk: int, truth: Floats) -> None:
        for robot, key in enumerate(self.noise_keys):
            self.bias_walk[robot] += self._walk_step[robot] * generator_at(
                key, 2 * chunk + 1
            ).standard_normal(self.bias_walk.shape[1])
        warmed = truth[:, self._housing] - self.cold
        self.offset[:] = self._bias + self.bias_walk + self._per_k * warmed

    def _prepare(self, chunk: int) -> None:
        if chunk == self._chunk:
            return
        self._chunk, width = chunk, len(self._sensor)
        begin, end = chunk * self._length, (chunk + 1) * self._length
        self._faults_of_chunk = [f for f in self._faults if f.begins <= end and f.ends > begin]
        for noise, key in zip(self._noise, self.noise_keys, strict=True):
            generator_at(key, 2 * chunk).standard_normal(out=noise)
        self._noise *= self._sigma[:, None]
        self._arrivals = self._packets.arriving(chunk)
        self._arrived = self._arrivals != NEVER
        self._arrived_channels = self._arrived[:, :, self._sensor]
        row = self._row + self._arrivals % self._packets.depth
        self._source = row[:, :, self._sensor] * width + np.arange(width)

    def _fail(self, fault: Fault, tick: int, reading: Floats) -> None:
        """Apply a fault to `reading`, in place; `held` keeps the last value before a channel got stuck."""
        columns = self.columns[fault.sensor]
        if fault.channel is not None:
            columns = slice(columns.start + fault.channel, columns.start + fault.channel + 1)
        own, held = reading[fault.robot, columns], self.held[fault.robot, columns]
        if not fault.begins <= tick < fault.ends:
            held[:] = own
        elif fault.what == Failure.STUCK:
            own[:] = held
        elif fault.what == Failure.GARBAGE:
            rng = generator_at(self._garbage_keys[fault.robot], tick)
            own[:] = rng.uniform(-1.0, 1.0, own.shape) * self._range[fault.robot, columns]
        elif fault.what == Failure.WRONG:
            own += WRONG * self._range[fault.robot, columns]
        elif fault.channel is not None and silent(fault, np.array([tick]), self._dt)[0]:
            own[:] = np.nan
