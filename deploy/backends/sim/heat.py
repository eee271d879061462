"""Motor temperatures of B plants: the windings, which MuJoCo's motors have, and the housings, which they lack."""

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.model import motor_parameters as motor
from deploy.stage import Stage
from robots.arrays import Floats
from robots.draws import Draw
from robots.spec import RobotSpec

CAPACITY_OFF = 1e12
"""J/K: heat capacity by which MuJoCo's own winding does not warm."""


class Windings(Stage):
    """The winding's temperature is MuJoCo's activation, a rise over the housing, which its resistance follows.

    It is integrated here: MuJoCo heats a saturated motor by the current that its voltage would drive, not by the one
    that its limit of torque lets through.

    MuJoCo's drives put the voltage on a motor that its winding needs at `REFERENCE_C` for the torque: hot, it gives
    less. That is so for motors without the mode "torque"; those that have it close a loop around the current, which
    finds the voltage whatever the temperature. Their drives are given the resistance of the present temperature.

    Attributes:
        square: (B, n) A², sum of the squared currents of the ticks since the last `warm`.
        drive_ohm: (B, n) of the winding, as its drive assumes it. A view of the model.
        to_housing: (B, n) K/W. capacity: (B, n) J/K.
    """

    carried = ("square", "drive_ohm")

    def __init__(self, spec: RobotSpec, batch: Batch, draw: Draw) -> None:
        gain, dynamics = batch.expand("actuator_gainprm"), batch.expand("actuator_dynprm")
        self._ohm, self._per_k, self._reference_c = (
            gain[:, :, place].copy()
            for place in (motor.RESISTANCE, motor.RESISTANCE_PER_K, motor.REFERENCE_C)
        )
        self.to_housing, self.capacity = (
            dynamics[:, :, place].copy() for place in (motor.WINDING_TO_HOUSING, motor.WINDING_CAPACITY)
        )
        dynamics[:, :, motor.WINDING_CAPACITY] = CAPACITY_OFF
        self.square = np.zeros((draw.robots, self._ohm.shape[1]))
        self._current_loops, self.drive_ohm = spec.current_loops, gain[:, :, motor.RESISTANCE]
        gain[:, self._current_loops, motor.RESISTANCE_PER_K] = 0.0

    def set_drive_resistance(self, rows: np.ndarray | slice, ohm: Floats) -> None:
        """Give the drives of robots `rows` with a current loop the resistance (B, n) of their windings."""
        self.drive_ohm[rows] = np.where(self._current_loops, ohm, self._ohm)[rows]

    def ohm(self, celsius: Floats) -> Floats:
        """Return the resistance (B, n) of windings at (B, n) °C."""
        ohm: Floats = self._ohm * (1.0 + self._per_k * (celsius - self._reference_c))
        return ohm

    def warm(self, rise: Floats, housing: Floats, ticks: int, dt: float) -> None:
        """Integrate over some ticks. Source: see `robots.motors.motor`; steps are far below the windings' seconds.

        Args:
            rise: (B, n) K, written. housing: (B, n) °C.
            ticks: number of ticks summed in `square`. dt: s.
        """
        loss = self.square * self.ohm(housing + rise)
        rise += dt / self.capacity * (loss - ticks * rise / self.to_housing)
        self.square[:] = 0.0


class Housings(Stage):
    """Motor housings, the ambient of MuJoCo's motors.

    Source: see `robots.motors.motor`. Iron loss, iron (gear qd)², and the heat of the joint's friction and damping
    warm the housing, where rotor, gear and bearings sit.

    Attributes:
        celsius: (B, n) °C.
        to_ambient: (B, n) K/W. capacity: (B, n) J/K.
    """

    carried = ("celsius",)

    def __init__(self, spec: RobotSpec, batch: Batch, draw: Draw) -> None:
        each = np.ones((draw.robots, spec.n))
        self._ambient = each * draw["climate.ambient_c"][:, None]
        self._start = self._ambient + draw["climate.warm_start_k"][:, None]
        dynamics = batch.expand("actuator_dynprm")
        self._ambient_of_winding = dynamics[:, :, motor.AMBIENT_C]
        self._winding_to_housing = dynamics[:, :, motor.WINDING_TO_HOUSING].copy()
        self.to_ambient = draw["drives.housing_to_ambient"] * spec.motor_array("housing_resistance_k_per_w")
        self.capacity = draw["drives.housing_capacity"] * spec.motor_array("housing_capacity_j_per_k")
        gear = batch.model.actuator_gear[:, 0]
        self._iron = draw["drives.iron_loss"] * spec.motor_array("iron_w_s2") * gear**2
        self.celsius = self._start.copy()
        self.apply()

    def reset(self, rows: np.ndarray) -> None:
        """Set robots `rows` to their temperature at the start."""
        self.celsius[rows] = self._start[rows]
        self.apply()

    def apply(self) -> None:
        """Write the temperatures into the model."""
        self._ambient_of_winding[:] = self.celsius

    def warm(self, rise: Floats, friction_j: Floats, speed_square: Floats, dt: float) -> None:
        """Integrate over `dt`; the windings keep their temperature when their ambient changes.

        Args:
            rise: (B, n) K, windings over housings, written.
            friction_j: (B, n) J, heat of friction.
            speed_square: (B, n) rad²/s, integral of the joints' squared speed over that time.
            dt: s, far below the housings' minutes.
        """
        watts = rise / self._winding_to_housing - (self.celsius - self._ambient) / self.to_ambient
        warming = (watts * dt + friction_j + self._iron * speed_square) / self.capacity
        self.celsius += warming
        rise -= warming
        self.apply()
