"""Disturbances of B robots that come and go.

A new one is a class listed in `DISTURBANCES`, a table of its drawn numbers in robots/distributions.py and every
draws.toml, and a random stream of its own in robots/randomness.py.

Every phase is a function of seed, robot and its number, so that only the numbers of the phases have to be saved.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.model.plant_model import PlantModel
from deploy.stage import Stage
from robots.arrays import Bools, Floats, Ints
from robots.draws import Draw
from robots.randomness import Stream, generator_at, stream_keys

Seeds = Sequence[np.random.SeedSequence]

DENSITY = 2700.0
"""kg/m³, aluminium: payloads are solid balls of it."""


class Intermittent(Stage, ABC):
    """Disturbance in phases of whole ticks, off in even ones and on in odd ones.

    Attributes:
        name: key in `Plant.disturbances`. stream: of its random numbers.
        phase: (B,) number of the present phase. until: (B,) tick at which it ends.
    """

    name: ClassVar[str]
    stream: ClassVar[Stream]
    carried: ClassVar[tuple[str, ...]] = ("phase", "until")

    def __init__(self, batch: Batch, plant: PlantModel, draw: Draw, seeds: Seeds, dt: float) -> None:
        """Begin the first phase of every robot at tick 0. A subclass reads the draw first, for `seconds`."""
        self._dt, self._keys = dt, stream_keys(seeds, self.stream)
        self.phase, self.until = np.zeros(len(seeds), dtype=np.int64), np.zeros(len(seeds), dtype=np.int64)
        self._extend(np.arange(len(seeds)))

    @abstractmethod
    def apply(self, rows: Ints) -> None:
        """Write the present phase of robots `rows` into their simulations."""

    @abstractmethod
    def seconds(self, robot: int) -> float:
        """Return the duration of the present phase of a robot, s."""

    @property
    def on(self) -> Bools:
        """(B,) present now."""
        return np.asarray(self.phase % 2 == 1)

    def step(self, tick: int) -> None:
        """Begin the next phase where one ends at `tick`."""
        if tick < self._next:
            return
        over = np.flatnonzero(self.until <= tick)
        self.phase[over] += 1
        self._extend(over)
        self.apply(over)

    def reset(self, rows: Ints) -> None:
        """Write again what a reset of robots `rows` cleared; nothing by default: the schedule goes on."""

    def apply_all(self) -> None:
        """Write restored phases into the simulations."""
        self._extend(np.zeros(0, dtype=np.int64))
        self.apply(np.arange(len(self.phase)))

    def rng(self, robot: int) -> np.random.Generator:
        """Return the random numbers of a robot's present phase."""
        return generator_at(self._keys[robot], int(self.phase[robot]))

    def _extend(self, rows: Ints) -> None:
        for robot in rows:
            self.until[robot] += max(1, round(self.seconds(robot) / self._dt))
        self._next = int(self.until.min())


class Payload(Intermittent):
    """Ball at the tool: off for `payload.free_s`, on for `payload.carried_s`; starts anywhere in that cycle.

    Attributes:
        tool_kg: (B,) by which the tool is heavier than the one that it should be, as such a ball.
    """

    name, stream = "payload", Stream.PAYLOAD
    carried = ("phase", "until", "tool_kg")

    def __init__(self, batch: Batch, plant: PlantModel, draw: Draw, seeds: Seeds, dt: float) -> None:
        self._batch, self._body = batch, plant.payload
        mass = draw["payload.mass_kg"]
        self._mass, self._inertia, self.tool_kg = mass, _ball_inertia(mass), np.zeros(len(mass))
        self._durations = np.stack((draw["payload.free_s"], draw["payload.carried_s"]))
        batch.expand("body_ipos")[:, self._body] = draw["payload.com_m"]
        super().__init__(batch, plant, draw, seeds, dt)
        cycle = self._durations.sum(axis=0)
        passed = [self.rng(robot).random() * cycle[robot] for robot in range(len(cycle))]
        self.until -= np.rint(np.array(passed) / dt).astype(np.int64)
        self.apply_all()
        self.step(0)

    def seconds(self, robot: int) -> float:
        """Return the drawn duration, s."""
        return float(self._durations[self.phase[robot] % 2, robot])

    def apply(self, rows: Ints) -> None:
        """Write mass and inertia, and derive MuJoCo's constants from them."""
        on, expand, tool_kg = self.on[rows], self._batch.expand, self.tool_kg[rows]
        inertia = on * self._inertia[rows] + _ball_inertia(tool_kg)
        expand("body_mass")[rows, self._body] = on * self._mass[rows] + tool_kg
        expand("body_inertia")[rows, self._body] = inertia[:, None]
        self._batch.set_const(rows)

    def change_tool(self, robot: int, heavier_kg: float) -> None:
        """Change the tool of a robot for one that is heavier than it should be; 0 brings the right one back."""
        if self.tool_kg[robot] != heavier_kg:
            self.tool_kg[robot] = heavier_kg
            self.apply(np.array([robot]))


def _ball_inertia(mass: Floats) -> Floats:
    """Return the inertia (B,) kg·m² of balls of `DENSITY` and mass (B,) kg."""
    radius = (mass * 3.0 / (4.0 * np.pi * DENSITY)) ** (1.0 / 3.0)
    return np.asarray(0.4 * mass * radius**2)


class Pushes(Intermittent):
    """Constant force on a random link: off for an exponential pause, on for `push.lasts_s`."""

    name, stream = "pushes", Stream.PUSHES

    def __init__(self, batch: Batch, plant: PlantModel, draw: Draw, seeds: Seeds, dt: float) -> None:
        self._applied, self._bodies = batch.bind("xfrc_applied"), plant.bodies
        self._force, self._every, self._lasts = (
            draw[f"push.{name}"] for name in ("force_n", "every_s", "lasts_s")
        )
        super().__init__(batch, plant, draw, seeds, dt)

    def seconds(self, robot: int) -> float:
        """Return the drawn duration of a push, or an exponential pause, s."""
        if self.phase[robot] % 2:
            return float(self._lasts[robot])
        return float(self.rng(robot).exponential(self._every[robot]))

    def apply(self, rows: Ints) -> None:
        """Write forces of random direction on random links."""
        self._applied[rows] = 0.0
        for robot in rows[self.on[rows]]:
            link, direction = self.drawn(robot)
            self._applied[robot, self._bodies[link], :3] = self._force[robot] * direction

    def drawn(self, robot: int) -> tuple[int, Floats]:
        """Return the link that is pushed in the present phase of a robot, and the direction (3,), world."""
        rng = self.rng(robot)
        direction = rng.standard_normal(3)
        return int(rng.choice(len(self._bodies))), direction / np.linalg.norm(direction)

    def reset(self, rows: Ints) -> None:
        """Write the forces again."""
        self.apply(rows)


DISTURBANCES: tuple[type[Intermittent], ...] = (Payload, Pushes)
"""Those of every plant, in the order in which they step."""
