"""The drives of B robots: what they follow and how late, their brakes, their current, and the supply they share."""

import math

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim import drawn
from deploy.masks import all_true, any_true
from deploy.motion.drive_law import Gains
from deploy.stage import Stage
from deploy.state import Command
from robots.arrays import Bools, Floats
from robots.distributions import COMMAND_DELAY_S
from robots.draws import Draw
from robots.models.mujoco_model import INPUTS
from robots.spec import RobotSpec
from robots.tables import Rates


class Drives(Stage):
    """Drives interpolate what a bus sends: taken as steps it would saturate the motors at every tick.

    `lines` (B, periods of physics, controls), newest last, is what they follow, on the motor's side: straight from
    command to command. Each robot's drives are at a place of it that lies `drives.delay_s` back.

    MuJoCo has no brakes: where they are closed the drive holds the pose that they closed on, with the gains that it has
    of its own, and the plant says that it takes no current for that.
    """

    carried = ("lines", "held", "braked")

    def __init__(self, spec: RobotSpec, batch: Batch, draw: Draw, gains: Gains | None = None) -> None:
        """Read gears, limits and delays; every drive begins with its brakes on at 0 rad.

        Args:
            spec: rates. batch: simulations of the robots. draw: the robots.
            gains: with power; None: their own.
        """
        robots, n = draw.robots, spec.n
        self.gear = np.ones((robots, n)) * batch.model.actuator_gear[:, 0]
        self.goal = np.zeros((robots, n * INPUTS))
        self._q, self._qd, self._feed = self.goal.reshape(robots, n, INPUTS).transpose(2, 0, 1)
        self.held, self.braked = np.zeros((robots, n)), np.ones(robots, dtype=bool)
        self._limit, self._nominal = batch.expand("actuator_forcerange"), batch.model.actuator_forcerange
        self._share = np.ones((robots, n))
        gain = batch.expand("actuator_gainprm")
        self._gain = gain[:, :, drawn.KP], gain[:, :, drawn.KD]
        self._brakes = self._gain[0].copy(), self._gain[1].copy()
        self._powered = self._brakes
        if gains:  # on the motor's side of the gear: an angle is that much larger there, and a torque smaller
            square = batch.model.actuator_gear[:, 0] ** 2
            self._powered = (gains.kp / square * draw["drives.kp"], gains.kd / square * draw["drives.kd"])
        self._lay_out(spec.rates, draw["drives.delay_s"])

    def _lay_out(self, rates: Rates, delay_s: Floats) -> None:
        """As many periods of control as the slowest bus needs. In memory time comes first: numpy is quicker so."""
        robots, controls = self.goal.shape
        substeps = rates.physics_hz // rates.control_hz
        late = np.rint(delay_s * rates.physics_hz).astype(np.int64)
        length = substeps * (1 + math.ceil(COMMAND_DELAY_S * rates.control_hz))
        course = np.zeros((length, robots, controls))
        self.lines = course.transpose(1, 0, 2)
        self._old, self._later = course[:-substeps], course[substeps:]
        self._new, self._last = course[-substeps:], course[-1]
        self._to_go = np.arange(1 - substeps, 1)[:, None, None] / substeps
        self._rows = course.reshape(-1, controls)
        place = length - substeps + np.arange(substeps) - late[:, None]
        self._places = place * robots + np.arange(robots)[:, None]
        self._control = np.zeros((robots, substeps, controls))

    def follow(self, command: Command, q: Floats) -> Floats:
        """(B, substeps, controls) for the coming period; where the drives are off, brakes close on `q` (B, n) rad."""
        np.multiply(command.q, self.gear, out=self._q)
        np.multiply(command.qd, self.gear, out=self._qd)
        np.divide(command.tau, self.gear, out=self._feed)
        way = self.goal - self._last
        self._old[:] = self._later
        np.multiply(self._to_go, way, out=self._new)
        self._new += self.goal
        if not all_true(command.current == self._share):
            self._share[:] = command.current
            self._limit[:] = self._nominal * self._share[:, :, None]
        off = ~command.powered
        if any_true(self.braked & command.powered):
            self.braked &= off
            self.apply()
        if any_true(off):
            self.brake(off, q)
        return self._rows.take(self._places, axis=0, out=self._control, mode="clip")

    def brake(self, ids: Bools, q: Floats) -> None:
        """Close the brakes of robots where `ids` (B,) holds on the motors' angles `q` (B, n) rad, at once."""
        closing = ids & ~self.braked
        self.held[closing] = q[closing]
        self.braked |= ids
        if any_true(closing):
            self.apply()
        self._hold(np.flatnonzero(self.braked))

    def rest(self, rows: np.ndarray, q: Floats) -> None:
        """Robots `rows` have stood at `q` (B, n) rad for a while, brakes on."""
        self.held[rows], self.braked[rows] = q[rows], True
        self.apply()
        self._hold(rows)

    def apply(self) -> None:
        """Give drives with power the gains of the policy, those in the brakes their own."""
        for gain, brakes, powered in zip(self._gain, self._brakes, self._powered, strict=True):
            gain[:] = np.where(self.braked[:, None], brakes, powered)

    def _hold(self, rows: np.ndarray) -> None:
        self._q[rows] = (self.held * self.gear)[rows]
        self._qd[rows] = self._feed[rows] = 0.0
        self.lines[rows] = self.goal[rows, None]


class Supply(Stage):
    """One source behind the resistance of its lines, whose voltage sinks under what the drives draw.

    Drives are converters: each takes the power u I of its motor from the bus, whatever current that is, so that the bus
    settles where V = V0 - R P / V. What one brakes with feeds the others, what all brake with goes to a resistor.
    Source: Erickson and Maksimovic, Fundamentals of Power Electronics (2001), ch. 3: an ideal converter as a DC
    transformer.

    `limit` (B, n) V is what MuJoCo's drives may put on their motors.
    """

    carried = ("limit",)

    def __init__(self, batch: Batch, draw: Draw, gear: Floats) -> None:
        """Read voltages."""
        self.limit = batch.expand("actuator_gainprm")[:, :, drawn.VOLTS]
        self._gear, self._volts = gear, self.limit.copy()
        self._ohm4 = 4.0 * draw["drives.supply_ohm"]

    def rest(self, rows: np.ndarray) -> None:
        """Robots `rows` draw nothing."""
        self.limit[rows] = self._volts[rows]

    def sink(self, current: Floats, qd: Floats, constant: Floats, ohm: Floats) -> None:
        """Follow what is drawn.

        Args:
            current: (B, n) A, of the motors. qd: (B, n) rad/s, of the joints.
            constant: (B, n) N·m/A. ohm: (B, n), of the windings as warm as they are.
        """
        volts = qd * self._gear * constant + current * ohm
        power = np.maximum((volts * current).sum(axis=1), 0.0)
        left = np.maximum(self._volts**2 - (self._ohm4 * power)[:, None], 0.0)
        self.limit[:] = 0.5 * (self._volts + np.sqrt(left))
