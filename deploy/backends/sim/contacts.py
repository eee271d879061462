"""Contacts of B plants: collisions, forces of allowed contacts, and a goal that can be touched."""

from collections.abc import Mapping

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from deploy.backends.sim.model.allowed_contacts import PARKED
from deploy.backends.sim.model.plant_model import PlantModel
from deploy.masks import any_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats

GHOST_M = 1.0
"""m: with a contact margin of minus this, and a gap of this much, MuJoCo counts contacts and gives them no force."""


class Contacts(Stage):
    """Contacts of B plants by MuJoCo's contact sensors.

    A goal that appears inside the robot would push it away. It becomes solid as soon as nothing touches it any more.

    Attributes:
        goal: (B, 3) m, the touchable goal. solid: (B,) it can be touched.
        places: of the contact sensors.
    """

    carried = ("goal", "solid")

    def __init__(self, batch: Batch, model: PlantModel, sensed: Floats) -> None:
        """Bind; `sensed` (B, sensors) is the plant's copy of `sensordata`."""
        self.places, self._base, self._sensed = model.contacts, model.base, sensed
        self._all, robots = batch.bind("ncon"), batch.nsim
        self.goal, self.solid = np.tile(PARKED, (robots, 1)), np.zeros(robots, dtype=bool)
        if sphere := self.places.sphere:
            self._place = batch.bind("mocap_pos")[:, sphere.mocap]
            self._margin = batch.expand("geom_margin")[:, sphere.geom]
            self._gap = batch.expand("geom_gap")[:, sphere.geom]
        self.apply()

    def reset(self, rows: NDArray[np.integer]) -> None:
        """Remove the goals of robots `rows`, which were moved, until the next `show`."""
        self.goal[rows], self.solid[rows] = PARKED, False
        self.apply()

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore saved arrays, bit for bit."""
        super().restore(arrays)
        self.apply()

    def apply(self) -> None:
        """Write goals and their solidity into the simulations."""
        if self.places.sphere:
            self._place[:] = self.goal
            self._margin[:] = np.where(self.solid, 0.0, -GHOST_M)
            self._gap[:] = np.where(self.solid, 0.0, GHOST_M)

    def show(self, goal: Floats) -> None:
        """Put the touchable goals where they are (B, 3) m, before the physics of a tick; NaN: there is none."""
        if not self.places.sphere:
            return
        place = np.where(np.isfinite(goal).all(axis=1, keepdims=True), goal, PARKED)
        moved = (place != self.goal).any(axis=1)
        left = ~(self.solid | moved) & (self._sensed[:, self.places.sphere.found] == 0.0)
        if any_true(moved | left):
            self.solid[:] = self.solid & ~moved | left
            self.goal[:] = place
            self.apply()

    @property
    def collision(self) -> Bools:
        """(B,) some contact that is not allowed; contacts with a floor do not count."""
        places, sensed = self.places, self._sensed
        found = self._all if self._base is None else sensed[:, self._base.self_contacts]
        if places.own.size:
            found = found - sensed[:, places.own].sum(axis=1)
        if places.sphere:
            touched = sensed[:, places.sphere.found]
            bad = np.where(self.solid, touched - sensed[:, places.goal].sum(axis=1), 0.0)
            found = found - touched + bad if self._base is None else found + bad
        return np.asarray(found > 0)

    @property
    def strongest_n(self) -> Floats:
        """(B,) N, normal force of the strongest contact, those with a limit of their own left out."""
        strongest, limited = self.places.strongest, self.places.limited
        if not limited.size:
            return self._sensed[:, int(strongest[0, 0])]
        forces = self._sensed[:, strongest]
        # Strongest first, both: where they begin to differ is a contact that is not in the other list. The frame of a
        # contact may have its axes the other way round there.
        allowed = self._sensed[:, limited.reshape(-1, 3)]
        order = np.argsort(-np.linalg.norm(allowed, axis=2), axis=1, kind="stable")
        allowed = np.take_along_axis(allowed, order[:, :, None], axis=1)
        other = np.ones(forces.shape[:2], dtype=bool)  # the last one is of no allowed contact
        other[:, :-1] = (np.abs(forces[:, :-1]) != np.abs(allowed)).any(axis=2)
        return np.asarray(forces[np.arange(len(forces)), other.argmax(axis=1), 0])

    @property
    def allowed_n(self) -> Floats | None:
        """(B, P) N, normal force of the strongest contact of each pair with a limit; None without such pairs."""
        limited = self.places.limited
        return self._sensed[:, limited[:, :, 0]].max(axis=2) if limited.size else None
