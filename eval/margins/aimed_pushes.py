"""Pushes along the motion of a joint or of the tool, which throw links through the play of their gears.

A soak pushes at random moments. What a push does at the worst one would take many trials to meet by chance.
"""

import numpy as np
import pinocchio as pin

from deploy.backends.sim.plant import Plant
from eval.margins.excess import Values
from robots.arrays import Bools, Floats, Ints
from robots.draws import Draw
from robots.models.nominal_model import load_pinocchio
from robots.spec import RobotSpec

NEAR = 0.9
"""A push begins at this share of the highest speed that was planned so far."""
PAUSE_S = 0.5
"""s before the first push, and between two."""
NOBODY = -1
"""Aim of a robot that is not pushed."""


class AimedPushes:
    """Forces of B robots, each `push.force_n` for `push.lasts_s`, on a random link behind the joint that is aimed at.

    Attributes:
        on: (B,) pushed now.
    """

    on: Bools

    def __init__(self, spec: RobotSpec, plant: Plant, robots: Draw, aims: Ints, seed: int) -> None:
        """Wait for the first moment.

        Args:
            robots: B robots as they are.
            aims: (B,) joint, n for the tool, or `NOBODY`.
            seed: of the links.
        """
        self._n, self._aims, self._aimed = spec.n, aims, aims != NOBODY
        self._applied, self._bodies = plant.batch.bind("xfrc_applied"), plant.bodies
        self._force, self._ticks = robots["push.force_n"], np.rint(robots["push.lasts_s"] / spec.dt)
        self._centres = robots["links.com_m"]
        self._pause, self._rng = round(PAUSE_S / spec.dt), np.random.default_rng([seed, 2])
        self._model, _ = load_pinocchio(spec)
        self._data = self._model.createData()
        self._tick, self._until, self._fastest = 0, *np.zeros((2, len(aims)))
        self.on = np.zeros(len(aims), dtype=bool)

    def step(self, planned: Values, q: Floats, qd: Floats) -> None:
        """End and begin pushes after a tick.

        Args:
            planned: speeds, as in `Excess`. q, qd: (B, n) rad and rad/s, true.
        """
        speeds = np.hstack([planned["speed"], planned.get("tool_speed", np.zeros((len(q), 1)))])
        speed = np.take_along_axis(speeds, self._aims[:, None], axis=1)[:, 0]
        self._fastest = np.maximum(self._fastest, speed)
        self._applied[self.on & (self._tick >= self._until)] = 0.0
        self.on &= self._tick < self._until
        waited = self._tick >= self._until + self._pause
        begin = self._aimed & waited & ~self.on & (speed > 0.0) & (speed >= NEAR * self._fastest)
        for robot in np.flatnonzero(begin).tolist():
            link, direction = self._push(robot, q[robot], qd[robot])
            self._applied[robot, self._bodies[link], :3] = self._force[robot] * direction
        self._until[begin] = (self._tick + self._ticks)[begin]
        self.on |= begin
        self._tick += 1

    def _push(self, robot: int, q: Floats, qd: Floats) -> tuple[int, Floats]:
        """Return the link that is pushed at its drawn centre of mass, and the direction (3,) of the push, world."""
        aim = int(self._aims[robot])
        tool = aim == self._n
        link = self._n - 1 if tool else int(self._rng.integers(aim, self._n))
        pin.computeJointJacobians(self._model, self._data, q)
        jacobian = pin.getJointJacobian(self._model, self._data, link + 1, pin.LOCAL_WORLD_ALIGNED)
        centre = self._model.inertias[link + 1].lever + self._centres[robot, link]
        arm = self._data.oMi[link + 1].rotation @ centre
        levers = jacobian[:3] + np.cross(jacobian[3:], arm, axisa=0, axisc=0)
        velocity = levers @ (qd if tool else qd * (np.arange(self._n) == aim))
        return link, velocity / max(float(np.linalg.norm(velocity)), 1e-9)
