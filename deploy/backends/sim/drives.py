"""The drives of B robots: what they follow and how late, their brakes, their current, and the supply they share."""

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim import drawn
from deploy.flags import every, some
from deploy.stage import Stage
from deploy.state import Bools, Command, Floats
from robots.draws import Draw
from robots.model_mujoco import INPUTS
from robots.spec import RobotSpec


class Drives(Stage):
    """Drives interpolate what a bus sends: taken as steps it would saturate the motors at every tick.

    `lines` holds what they follow, on the motor's side, one row for each period of physics, newest last: straight from
    command to command. Each robot's own drives are at a place of it that lies `drives.delay_s` back.
    """

    carried = ("lines", "held", "braked")

    def __init__(self, spec: RobotSpec, batch: Batch, draw: Draw) -> None:
        """Read gears, limits and delays; every drive begins with its brakes on at 0 rad."""
        robots, n = draw.robots, spec.n
        self.gear = np.ones((robots, n)) * batch.model.actuator_gear[:, 0]
        late = np.rint(draw["drives.delay_s"] * spec.rates.physics_hz).astype(np.int64)
        substeps = spec.rates.physics_hz // spec.rates.control_hz
        self._way = np.arange(1, substeps + 1)[:, None] / substeps
        length = substeps * (1 - int(-late.max() // substeps))
        self.lines = np.zeros((robots, length, n * INPUTS))
        self._old, self._before = self.lines[:, :-substeps], self.lines[:, substeps:]
        self._new, self._newest = self.lines[:, -substeps:], self.lines[:, -1]
        places = length - substeps + np.arange(substeps) - late[:, None]
        self._places = places + np.arange(robots)[:, None] * length
        self._control = np.zeros((robots, substeps, n * INPUTS))
        self.goal = np.zeros((robots, n * INPUTS))
        self._q, self._qd, self._feed = self.goal.reshape(robots, n, INPUTS).transpose(2, 0, 1)
        self.held, self.braked = np.zeros((robots, n)), np.ones(robots, dtype=bool)
        self._limit, self._nominal = batch.expand("actuator_forcerange"), batch.model.actuator_forcerange
        self._share = np.ones((robots, n))

    def follow(self, command: Command, q: Floats) -> Floats:
        """(B, substeps, controls) for the coming period; where the drives are off, brakes close on `q` (B, n) rad."""
        last = self._newest.copy()
        self._old[:] = self._before
        np.multiply(command.q, self.gear, out=self._q)
        np.multiply(command.qd, self.gear, out=self._qd)
        np.divide(command.tau, self.gear, out=self._feed)
        np.multiply(self._way, (self.goal - last)[:, None], out=self._new)
        self._new += last[:, None]
        if not every(command.current == self._share):
            self._share[:] = command.current
            self._limit[:] = self._nominal * self._share[:, :, None]
        off = ~command.powered
        self.braked &= off
        if some(off):
            self.brake(off, q)
        rows = self.lines.reshape(-1, self.goal.shape[1])
        return rows.take(self._places, axis=0, out=self._control, mode="clip")

    def brake(self, ids: Bools, q: Floats) -> None:
        """Close the brakes of robots where `ids` (B,) holds on the motors' angles `q` (B, n) rad, at once.

        Brakes are the drive holding the pose that they closed on.
        """
        closing = ids & ~self.braked
        self.held[closing] = q[closing]
        self.braked |= ids
        self._hold(np.flatnonzero(self.braked))

    def rest(self, rows: np.ndarray, q: Floats) -> None:
        """Robots `rows` have stood at `q` (B, n) rad for a while, brakes on."""
        self.held[rows], self.braked[rows] = q[rows], True
        self._hold(rows)

    def _hold(self, rows: np.ndarray) -> None:
        self._q[rows] = (self.held * self.gear)[rows]
        self._qd[rows] = self._feed[rows] = 0.0
        self.lines[rows] = self.goal[rows, None]


class Supply:
    """One source behind the resistance of its lines, whose voltage sinks under what the drives draw.

    Drives are converters: each takes the power u I of its motor from the bus, whatever current that is, so that the bus
    settles where V = V0 - R P / V. What they brake with goes to a resistor of their own. Source: Erickson and
    Maksimovic, Fundamentals of Power Electronics (2001), ch. 3: an ideal converter as a DC transformer.
    """

    def __init__(self, batch: Batch, draw: Draw, gear: Floats) -> None:
        """Read voltages and resistances."""
        gain = batch.expand("actuator_gainprm")
        self._limit, self._resistance = gain[:, :, drawn.VOLTS], gain[:, :, drawn.R].copy()
        self._gear = gear
        self._volts = self._limit.copy()
        self._volts2, self._ohm4 = self._volts**2, 4.0 * draw["drives.supply_ohm"]

    def sink(self, current: Floats, qd: Floats, constant: Floats) -> None:
        """Set every drive's voltage limit by motor current (B, n) A, joint speed rad/s and torque constant N·m/A."""
        volts = qd * self._gear
        volts *= constant
        volts += current * self._resistance
        volts *= current
        power = volts.sum(axis=1)
        np.maximum(power, 0.0, out=power)
        power *= self._ohm4
        left = self._volts2 - power[:, None]
        np.maximum(left, 0.0, out=left)
        np.sqrt(left, out=left)
        left += self._volts
        np.multiply(left, 0.5, out=self._limit)
