"""Drives of B robots: interpolated setpoints and their delay, brakes, current limits, and the supply they share."""

import math
from collections.abc import Mapping

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from deploy.backends.sim.model.motor_parameters import KD, KP, TORQUE_CONSTANT, VOLTAGE_MAX
from deploy.masks import all_true, any_true
from deploy.stage import Stage
from deploy.state import Command
from robots.arrays import Bools, Floats
from robots.distributions import COMMAND_DELAY_S
from robots.draws import Draw
from robots.models.mujoco_model import INPUTS
from robots.motors.drive_gains import drive_gains
from robots.spec import RobotSpec
from robots.tables import Rates


class Drives(Stage):
    """Drives interpolate linearly between commands: taken as steps these would saturate the motors at every tick.

    MuJoCo has no brakes: where they are closed the drive holds the pose that they closed on, with the gains that it has
    of its own and the torque of that moment, as a locked shaft carries its load; if joints moved, it is off by what
    slowed or sped them up, at most the drive's range over its stiffness: 4 to 7 mrad. The plant reports no current.

    Attributes:
        history: (B, periods of physics, controls), newest last: setpoints on the motor's side. Each robot's drives
            follow them `drives.delay_s` late.
        command: (B, controls) the newest command, on the motor's side.
        held: (B, n) rad, pose held by the brakes. load: (B, n) N·m on the motor's side, when they closed.
        braked: (B,) brakes closed.
        slip: (B, n) rad by which encoders slipped on their shafts: drives and packets read that much more.
        gear: (B, n) ratio.
        gains: kp and kd in force, (B, n) each, on the motor's side. commanded_kp, commanded_kd: those of the newest
            command, at the joint.
        current_share: (B, n) share of its current that a drive may use.
        torque_limit: (B, n, 2) N·m on the motor's side, in force. torque_limit_nominal: (n, 2) at full current.
    """

    carried = ("history", "held", "load", "braked", "slip", "commanded_kp", "commanded_kd", "current_share")

    def __init__(self, spec: RobotSpec, batch: Batch, draw: Draw) -> None:
        """Begin with every brake closed at 0 rad."""
        robots, n = draw.robots, spec.n
        self.gear = np.ones((robots, n)) * batch.model.actuator_gear[:, 0]
        self.command = np.zeros((robots, n * INPUTS))
        self._q, self._qd, self._tau = self.command.reshape(robots, n, INPUTS).transpose(2, 0, 1)
        self.held, self.load = np.zeros((2, robots, n))
        self.braked = np.ones(robots, dtype=bool)
        self.slip = np.zeros((robots, n))
        self.torque_limit = batch.expand("actuator_forcerange")
        self.torque_limit_nominal = batch.model.actuator_forcerange
        self.current_share = np.ones((robots, n))
        gain = batch.expand("actuator_gainprm")
        self.gains, self._constant = (gain[:, :, KP], gain[:, :, KD]), gain[:, :, TORQUE_CONSTANT]
        self._own = self.gains[0].copy(), self.gains[1].copy()
        self._nominal, self._factors = drive_gains(spec), (draw["drives.kp"], draw["drives.kd"])
        self.commanded_kp, self.commanded_kd = (np.tile(gain, (robots, 1)) for gain in self._nominal)
        self._allocate(spec.rates, draw["drives.delay_s"])

    def _allocate(self, rates: Rates, delay_s: Floats) -> None:
        """Allocate the history, as long as the slowest bus needs. Time comes first in memory, which is faster."""
        robots, controls = self.command.shape
        substeps = rates.physics_hz // rates.control_hz
        late = np.rint(delay_s * rates.physics_hz).astype(np.int64)
        length = substeps * (1 + math.ceil(COMMAND_DELAY_S * rates.control_hz))
        course = np.zeros((length, robots, controls))
        self.history = course.transpose(1, 0, 2)
        self._old, self._later = course[:-substeps], course[substeps:]
        self._new, self._last = course[-substeps:], course[-1]
        self._to_go = np.arange(1 - substeps, 1)[:, None, None] / substeps
        self._rows = course.reshape(-1, controls)
        place = length - substeps + np.arange(substeps) - late[:, None]
        self._places = place * robots + np.arange(robots)[:, None]
        self._control = np.zeros((robots, substeps, controls))

    def step(self, command: Command, q: Floats, current: Floats) -> Floats:
        """Return the controls (B, substeps, controls) of the coming period.

        Brakes of robots whose drives are off close on the motors' angles q (B, n) rad; these carry `current` (B, n) A.
        """
        np.subtract(command.q, self.slip, out=self._q)
        self._q *= self.gear
        np.multiply(command.qd, self.gear, out=self._qd)
        np.divide(command.tau, self.gear, out=self._tau)
        difference = self.command - self._last
        self._old[:] = self._later
        np.multiply(self._to_go, difference, out=self._new)
        self._new += self.command
        if not all_true(command.current_share == self.current_share):
            self.current_share[:] = command.current_share
            self._limit_torque()
        off, drive = ~command.powered, command.drive
        opening = any_true(self.braked & command.powered)
        if opening:
            self.braked &= off
        if opening or not (
            all_true(drive.kp == self.commanded_kp) and all_true(drive.kd == self.commanded_kd)
        ):
            self.commanded_kp[:], self.commanded_kd[:] = drive.kp, drive.kd
            self.apply()
        if any_true(off):
            self.brake(off, q, current)
        return self._rows.take(self._places, axis=0, out=self._control, mode="clip")

    def wait(self, robot: int) -> Floats:
        """Return the controls (1, substeps, controls) of one robot for a period in which no command arrives."""
        course, substeps = self.history[robot], self._control.shape[1]
        course[:-substeps] = course[substeps:]
        course[-substeps:] = course[-1]
        return self._rows.take(self._places[robot : robot + 1], axis=0)

    def slip_encoder(self, robot: int, joint: int, rad: float) -> None:
        """Turn a joint's encoder on its shaft, to `rad` from where it was mounted; brakes hold the shaft itself."""
        moved = rad - self.slip[robot, joint]
        self.slip[robot, joint] = rad
        if not self.braked[robot]:
            self.history[robot, :, joint * INPUTS] -= moved * self.gear[robot, joint]

    def brake(self, ids: Bools, q: Floats, current: Floats) -> None:
        """Close the brakes of robots where `ids` (B,) holds on the motors' angles `q` (B, n) rad, at once.

        The motors carry `current` (B, n) A.
        """
        closing = ids & ~self.braked
        self.braked |= ids
        if any_true(closing):
            self.held[closing] = q[closing]
            self.load[closing] = current[closing] * self._constant[closing]
            self.apply()
        self._hold(np.flatnonzero(self.braked))

    def rest(self, rows: np.ndarray, q: Floats) -> None:
        """Put robots `rows` to rest at `q` (B, n) rad, brakes closed, as if they had stood there for a while."""
        self.held[rows], self.load[rows], self.braked[rows] = q[rows], 0.0, True
        self.apply()
        self._hold(rows)

    def apply(self) -> None:
        """Write the gains: the commanded ones where there is power, the drives' own where brakes are closed.

        On the motor's side of the gear an angle is that much larger, and a torque smaller.
        """
        square, commands = self.gear**2, (self.commanded_kp, self.commanded_kd)
        for gain, own, nominal, commanded, factor in zip(
            self.gains, self._own, self._nominal, commands, self._factors, strict=True
        ):
            powered = np.where(commanded == nominal, own, commanded / square * factor)
            gain[:] = np.where(self.braked[:, None], own, powered)

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore saved arrays, bit for bit."""
        super().restore(arrays)
        self.apply()
        self._limit_torque()

    def _limit_torque(self) -> None:
        self.torque_limit[:] = self.torque_limit_nominal * self.current_share[:, :, None]

    def _hold(self, rows: np.ndarray) -> None:
        self._q[rows] = (self.held * self.gear)[rows]
        self._qd[rows], self._tau[rows] = 0.0, self.load[rows]
        self.history[rows] = self.command[rows, None]


class Supply(Stage):
    """One voltage source behind the resistance of its lines, whose voltage drops under the power of the drives.

    Drives are converters: each takes the power u I of its motor from the bus, whatever current that is, so that the bus
    settles where V = V0 - R P / V. Regenerated power feeds the other drives; a net surplus goes to a resistor.
    Source: Erickson and Maksimovic, Fundamentals of Power Electronics (2001), ch. 3: an ideal converter as a DC
    transformer.

    Attributes:
        limit: (B, n) V that MuJoCo's drives may put on their motors.
    """

    carried = ("limit",)

    def __init__(self, batch: Batch, draw: Draw, gear: Floats) -> None:
        self.limit = batch.expand("actuator_gainprm")[:, :, VOLTAGE_MAX]
        self._gear, self._volts = gear, self.limit.copy()
        self._ohm4 = 4.0 * draw["drives.supply_ohm"]

    def rest(self, rows: np.ndarray) -> None:
        """Set robots `rows` to no load."""
        self.limit[rows] = self._volts[rows]

    def update(self, current: Floats, qd: Floats, constant: Floats, ohm: Floats) -> None:
        """Set the voltage for the present power.

        Args:
            current: (B, n) A, of the motors. qd: (B, n) rad/s, of the joints.
            constant: (B, n) N·m/A. ohm: (B, n), of the windings at their temperature.
        """
        volts = qd * self._gear * constant + current * ohm
        power = np.maximum((volts * current).sum(axis=1), 0.0)
        left = np.maximum(self._volts**2 - (self._ohm4 * power)[:, None], 0.0)
        self.limit[:] = 0.5 * (self._volts + np.sqrt(left))
