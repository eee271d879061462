"""Distances between the shapes of a robot, by MuJoCo, at nominal poses and in a simulation."""

from itertools import combinations

import mujoco
import numpy as np

from deploy.backends.sim.plant import Plant
from robots.arrays import Floats
from robots.models.mujoco_model import load_mujoco
from robots.spec import RobotSpec

FAR_M = 0.3
"""m at which shapes count as out of each other's reach."""


class Gaps:
    """Distances of P pairs of shapes that may not meet, at most `FAR_M`.

    Attributes:
        pairs: of geoms of the nominal model: on links that are neither the same, nor parent and child, nor excluded.
    """

    def __init__(self, spec: RobotSpec, plant: Plant) -> None:
        """Find the same geoms in the nominal model and in the plant's."""
        self._model = model = load_mujoco(spec)
        self._data = mujoco.MjData(model)
        self._q = [model.joint(name).qposadr[0] for name in spec.joint_names]
        self.pairs = tuple(pair for pair in combinations(range(model.ngeom), 2) if _may_meet(model, *pair))
        ids = [_same_geom(model, geom, plant.batch.model) for geom in range(model.ngeom)]
        position, rotation = plant.batch.bind("geom_xpos"), plant.batch.bind("geom_xmat")
        self._true = [(position[:, geom], rotation[:, geom]) for geom in ids]

    def planned(self, q: Floats) -> Floats:
        """Return (B, P) m of the nominal robot at angles (B, n) rad."""
        return np.array([self._distances(self._place(row)) for row in q])

    def true(self) -> Floats:
        """Return (B, P) m of the simulated robots."""
        robots = len(self._true[0][0])
        return np.array([self._distances(self._copy(robot)) for robot in range(robots)])

    def _place(self, q: Floats) -> mujoco.MjData:
        self._data.qpos[self._q] = q
        mujoco.mj_kinematics(self._model, self._data)
        return self._data

    def _copy(self, robot: int) -> mujoco.MjData:
        for geom, (position, rotation) in enumerate(self._true):
            self._data.geom_xpos[geom], self._data.geom_xmat[geom] = position[robot], rotation[robot]
        return self._data

    def _distances(self, data: mujoco.MjData) -> list[float]:
        return [mujoco.mj_geomDistance(self._model, data, a, b, FAR_M, None) for a, b in self.pairs]


def _may_meet(model: mujoco.MjModel, a: int, b: int) -> bool:
    """Return True if MuJoCo makes contacts between two geoms."""
    first, second = (int(model.body_weldid[model.geom_bodyid[geom]]) for geom in (a, b))
    up = {int(model.body_weldid[model.body_parentid[body]]): body for body in (first, second) if body}
    related = first == second or (
        (up.get(first) == second or up.get(second) == first) and 0 not in (first, second)
    )
    bodies = sorted(int(model.geom_bodyid[geom]) for geom in (a, b))
    excluded = (bodies[0] << 16) + bodies[1] in model.exclude_signature
    types = model.geom_contype[[a, b]] & model.geom_conaffinity[[b, a]]
    return not related and not excluded and bool(types.any())


def _same_geom(nominal: mujoco.MjModel, geom: int, plant: mujoco.MjModel) -> int:
    """Return the id that a geom of the nominal model has in the plant's, where bodies have more geoms behind it."""
    body = nominal.body(int(nominal.geom_bodyid[geom]))
    return int(plant.body(body.name).geomadr[0] + geom - body.geomadr[0])
