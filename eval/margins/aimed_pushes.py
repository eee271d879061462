"""Pushes along the motion of a joint or of the tool, which throw links through the play of their gears.

A soak pushes at random moments. What a push does at the worst one would take many trials to meet by chance.
"""

from enum import IntEnum
from typing import NamedTuple

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


class Moment(IntEnum):
    """Moment at which a push begins, of a joint or a tool that is near its highest speed."""

    FAST = 0
    BRAKING = 1
    """The planned speed begins to fall."""
    STOPPING = 2
    """A stop of the runtime begins: gears that drove their links carry nothing for a moment."""


class Aims(NamedTuple):
    """Targets of the pushes of B robots.

    Attributes:
        joints: (B,) joint along whose motion, n for the tool, or `NOBODY`.
        links: (B,) link that is pushed.
        moments: (B,) of `Moment`.
    """

    joints: Ints
    links: Ints
    moments: Ints


class AimedPushes:
    """Forces of B robots, each `push.force_n` for `push.lasts_s`.

    Attributes:
        on: (B,) pushed now.
    """

    on: Bools

    def __init__(self, spec: RobotSpec, plant: Plant, robots: Draw, aims: Aims) -> None:
        """Wait for the first moment. `robots`: B robots as they are."""
        self._n, self._aims = spec.n, aims
        self._applied, self._bodies = plant.batch.bind("xfrc_applied"), plant.bodies
        self._force, self._ticks = robots["push.force_n"], np.rint(robots["push.lasts_s"] / spec.dt)
        self._centres = robots["links.com_m"]
        self._pause = round(PAUSE_S / spec.dt)
        self._model, _ = load_pinocchio(spec)
        self._data = self._model.createData()
        self._tick, (self._until, self._fastest, self._before) = 0, np.zeros((3, len(aims.joints)))
        self.on = np.zeros(len(aims.joints), dtype=bool)

    def step(self, planned: Values, q: Floats, qd: Floats, stops: Bools) -> None:
        """End and begin pushes after a tick.

        Args:
            planned: speeds, as in `Excess`. q, qd: (B, n) rad and rad/s, true. stops: (B,) a stop began in this tick.
        """
        speeds = np.hstack([planned["speed"], planned.get("tool_speed", np.zeros((len(q), 1)))])
        speed = np.take_along_axis(speeds, self._aims.joints[:, None], axis=1)[:, 0]
        self._fastest = np.maximum(self._fastest, speed)
        self._applied[self.on & (self._tick >= self._until)] = 0.0
        self.on &= self._tick < self._until
        waited = self._tick >= self._until + self._pause
        moment = np.choose(self._aims.moments, (speed > 0.0, speed < self._before, stops))
        fast = speed >= NEAR * self._fastest
        begin = fast & moment & waited & ~self.on & (self._aims.joints != NOBODY)
        for robot in np.flatnonzero(begin).tolist():
            body = self._bodies[self._aims.links[robot]]
            self._applied[robot, body, :3] = self._force[robot] * self._direction(robot, q[robot], qd[robot])
        self._until[begin] = (self._tick + self._ticks)[begin]
        self.on |= begin
        self._before = speed
        self._tick += 1

    def _direction(self, robot: int, q: Floats, qd: Floats) -> Floats:
        """Return the direction (3,), world, in which the joint or all joints move the link's drawn centre of mass."""
        joint, link = int(self._aims.joints[robot]), int(self._aims.links[robot])
        pin.computeJointJacobians(self._model, self._data, q)
        jacobian = pin.getJointJacobian(self._model, self._data, link + 1, pin.LOCAL_WORLD_ALIGNED)
        centre = self._model.inertias[link + 1].lever + self._centres[robot, link]
        arm = self._data.oMi[link + 1].rotation @ centre
        levers = jacobian[:3] + np.cross(jacobian[3:], arm, axisa=0, axisc=0)
        velocity = levers @ (qd if joint == self._n else qd * (np.arange(self._n) == joint))
        return np.asarray(velocity / max(float(np.linalg.norm(velocity)), 1e-9))
