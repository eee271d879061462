"""What the simulated bus delivers: encoders that are noisy, coarse, late, and sometimes silent."""

from collections.abc import Sequence

import numpy as np

from deploy.stage import Stage
from deploy.state import Bools, Floats, Sample
from robots.draws import Draw
from robots.randomness import keyed, keys
from robots.spec import RobotSpec

CHUNK = 256
"""Ticks of noise made at once; noise is a function of seed, robot and tick."""


class Sensors(Stage):
    """Encoder packets of B robots: taken every tick, arriving whole ticks later, or never."""

    carried = ("taken", "q", "t", "tick")

    def __init__(self, spec: RobotSpec, draw: Draw, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Read the lies each robot's draw tells."""
        robots = len(seeds)
        self._dt = spec.dt
        self._resolution: Floats = np.full((robots, spec.n), spec.encoder.resolution_rad)
        self._sigma, self._loss, self._keys = draw.noise_rad, draw.loss, keys(seeds, purpose=1)
        # The runtime looks once a tick: a packet is seen at the first tick after it has arrived.
        self._lag = np.ceil(draw.delay_s / spec.dt - 1e-9).astype(np.int64)
        self._depth = int(self._lag.max()) + 1
        self.taken = np.zeros((robots, self._depth, spec.n))
        self._packets = self.taken.reshape(-1, spec.n)
        # For each place in the ring that the present may have: the packets that arrive then.
        present = np.arange(self._depth)[:, None]
        self._arriving = np.arange(robots) * self._depth + (present - self._lag) % self._depth
        self.q, self.t = np.zeros((robots, spec.n)), np.zeros(robots)
        self.tick = np.zeros(1, dtype=np.int64)
        self._noise = np.zeros((CHUNK, robots, spec.n))
        self._kept = np.zeros((CHUNK, robots), dtype=bool)
        self._chunk = -1

    def reset(self, ids: Bools, q: Floats) -> None:
        """Robots where `ids` holds have stood at `q` (B, n) rad for a while."""
        self.taken[ids] = self._quantized(q)[ids, None, :]

    def take(self, q: Floats) -> None:
        """Move on one tick and put the true angles `q` (B, n) rad on the bus."""
        self.tick += 1
        tick = int(self.tick[0])
        self._need(tick)
        self.taken[:, tick % self._depth] = self._quantized(q + self._noise[tick % CHUNK])

    def read(self, current: Floats, temperature: Floats) -> Sample:
        """The newest packet that has arrived; motor readings ride along undelayed, temperature in whole °C."""
        tick = int(self.tick[0])
        self._need(tick)
        fresh = self._kept[tick % CHUNK].copy()
        newest = self._packets.take(self._arriving[tick % self._depth], axis=0)
        np.copyto(self.q, newest, where=fresh[:, None])
        np.copyto(self.t, (tick - self._lag) * self._dt, where=fresh)
        return Sample(t=self.t, fresh=fresh, q=self.q, current=current, temperature=np.rint(temperature))

    def _quantized(self, q: Floats) -> Floats:
        return np.rint(q / self._resolution) * self._resolution

    def _need(self, tick: int) -> None:
        """Make the noise of the chunk that `tick` is in."""
        chunk = tick // CHUNK
        if chunk == self._chunk:
            return
        self._chunk = chunk
        for robot, key in enumerate(self._keys):
            rng = keyed(key, chunk)
            self._noise[:, robot] = self._sigma[robot] * rng.standard_normal((CHUNK, self.q.shape[1]))
            self._kept[:, robot] = rng.random(CHUNK) >= self._loss[robot]
