"""What happens to B robots from outside, in turns: a payload that comes and goes, and pushes.

Every turn is a function of seed, robot and its number, so that nothing but the numbers of the turns has to be kept.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.anatomy import Anatomy
from deploy.stage import Stage
from robots.arrays import Bools, Ints
from robots.draws import Draw
from robots.randomness import keyed, keys

Seeds = Sequence[np.random.SeedSequence]

DENSITY = 2700.0
"""kg/m³, aluminium: what payloads are balls of."""


class Turns(Stage, ABC):
    """Off and on in turns of whole ticks: even numbers are off."""

    purpose: ClassVar[int]
    carried = ("turn", "until")

    def __init__(self, seeds: Seeds, dt: float) -> None:
        """Begin the first turn of every robot at tick 0."""
        self._dt, self._keys = dt, keys(seeds, self.purpose)
        self.turn, self.until = np.zeros(len(seeds), dtype=np.int64), np.zeros(len(seeds), dtype=np.int64)
        self._time(np.arange(len(seeds)))

    @abstractmethod
    def apply(self, rows: Ints) -> None:
        """Write into the simulations of robots `rows` whether it is there."""

    @abstractmethod
    def seconds(self, robot: int) -> float:
        """How long the present turn of a robot lasts."""

    @property
    def on(self) -> Bools:
        """(B,) whether it is there."""
        return np.asarray(self.turn % 2 == 1)

    def step(self, tick: int) -> None:
        """Let turns that are over at `tick` be followed by the next."""
        if tick < self._next:
            return
        over = np.flatnonzero(self.until <= tick)
        self.turn[over] += 1
        self._time(over)
        self.apply(over)

    def follow(self) -> None:
        """Write turns that were restored into the simulations."""
        self._time(np.zeros(0, dtype=np.int64))
        self.apply(np.arange(len(self.turn)))

    def rng(self, robot: int) -> np.random.Generator:
        """The random numbers of a robot's present turn."""
        return keyed(self._keys[robot], int(self.turn[robot]))

    def _time(self, rows: Ints) -> None:
        for robot in rows:
            self.until[robot] += max(1, round(self.seconds(robot) / self._dt))
        self._next = int(self.until.min())


class Payload(Turns):
    """A ball at the tool: off for `payload.free_s`, on for `payload.carried_s`, from anywhere in that cycle on."""

    purpose = 3

    def __init__(self, batch: Batch, anatomy: Anatomy, draw: Draw, seeds: Seeds, dt: float) -> None:
        """Read the draw and begin."""
        self._batch, self._body = batch, anatomy.payload
        mass = draw["payload.mass_kg"]
        radius = (mass * 3.0 / (4.0 * np.pi * DENSITY)) ** (1.0 / 3.0)
        self._mass, self._inertia = mass, 0.4 * mass * radius**2
        self._durations = np.stack((draw["payload.free_s"], draw["payload.carried_s"]))
        batch.expand("body_ipos")[:, self._body] = draw["payload.com_m"]
        super().__init__(seeds, dt)
        cycle = self._durations.sum(axis=0)
        begun = [self.rng(robot).random() * cycle[robot] for robot in range(len(cycle))]
        self.until -= np.rint(np.array(begun) / dt).astype(np.int64)
        self.follow()
        self.step(0)

    def seconds(self, robot: int) -> float:
        """As drawn."""
        return float(self._durations[self.turn[robot] % 2, robot])

    def apply(self, rows: Ints) -> None:
        """Mass and inertia, and what MuJoCo derives from them."""
        on, expand = self.on[rows], self._batch.expand
        expand("body_mass")[rows, self._body] = on * self._mass[rows]
        expand("body_inertia")[rows, self._body] = (on * self._inertia[rows])[:, None]
        self._batch.set_const(rows)


class Pushes(Turns):
    """A force on a link, constant while it lasts: off for an exponential pause, on for `push.lasts_s`."""

    purpose = 2

    def __init__(self, batch: Batch, anatomy: Anatomy, draw: Draw, seeds: Seeds, dt: float) -> None:
        """Read the draw."""
        self._applied, self._bodies = batch.bind("xfrc_applied"), anatomy.bodies
        self._force, self._every, self._lasts = (
            draw[f"push.{name}"] for name in ("force_n", "every_s", "lasts_s")
        )
        super().__init__(seeds, dt)

    def seconds(self, robot: int) -> float:
        """As drawn, or an exponential pause."""
        if self.turn[robot] % 2:
            return float(self._lasts[robot])
        return float(self.rng(robot).exponential(self._every[robot]))

    def apply(self, rows: Ints) -> None:
        """From anywhere, on any link."""
        self._applied[rows] = 0.0
        for robot in rows[self.on[rows]]:
            rng = self.rng(robot)
            way = rng.standard_normal(3)
            self._applied[robot, rng.choice(self._bodies), :3] = (
                self._force[robot] * way / np.linalg.norm(way)
            )
