"""How B robots' motors warm: the windings, whose resistance MuJoCo's motors know, and the housings, which they lack."""

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim import drawn
from deploy.stage import Stage
from robots.arrays import Floats
from robots.draws import Draw
from robots.spec import RobotSpec

STILL = 1e12
"""J/K: the capacity by which MuJoCo's own winding does not warm."""


class Windings(Stage):
    """The winding's node is MuJoCo's activation, a rise over the housing, which its resistance follows.

    It is integrated here: MuJoCo heats a saturated motor by the current that its voltage would drive, not by the one
    that its limit of torque lets through.

    Attributes:
        square: (B, n) A², the squared currents of the ticks since the last time.
        to_housing: (B, n) K/W. capacity: (B, n) J/K.
    """

    carried = ("square",)

    def __init__(self, batch: Batch, draw: Draw) -> None:
        """Read the motors, and keep MuJoCo from warming them."""
        gain, dynamics = batch.expand("actuator_gainprm"), batch.expand("actuator_dynprm")
        self._ohm, self._alpha, self._cold = (
            gain[:, :, place].copy() for place in (drawn.R, drawn.ALPHA, drawn.COLD)
        )
        self.to_housing, self.capacity = (dynamics[:, :, place].copy() for place in (drawn.RWH, drawn.CW))
        dynamics[:, :, drawn.CW] = STILL
        self.square = np.zeros((draw.robots, self._ohm.shape[1]))

    def ohm(self, celsius: Floats) -> Floats:
        """(B, n) what windings of (B, n) °C resist."""
        ohm: Floats = self._ohm * (1.0 + self._alpha * (celsius - self._cold))
        return ohm

    def warm(self, rise: Floats, housing: Floats, ticks: int, dt: float) -> None:
        """Live through some ticks of `dt` s. Source: see `robots.motor`; steps are far below the windings' seconds.

        Args:
            rise: (B, n) K, written. housing: (B, n) °C.
            ticks: how many `square` is of. dt: s.
        """
        loss = self.square * self.ohm(housing + rise)
        rise += dt / self.capacity * (loss - ticks * rise / self.to_housing)
        self.square[:] = 0.0


class Housings(Stage):
    """What the windings lie in, and what MuJoCo's motors take for their ambient.

    Source: see `robots.motor`. Iron loss, iron (gear qd)², and what the joint's friction and damping turn into heat
    warm the housing, where rotor, gear and bearings sit.

    Attributes:
        celsius: (B, n) °C.
        to_ambient: (B, n) K/W. capacity: (B, n) J/K.
    """

    carried = ("celsius",)

    def __init__(self, spec: RobotSpec, batch: Batch, draw: Draw) -> None:
        """Read the motors; every housing begins as warm as drawn."""
        each = np.ones((draw.robots, spec.n))
        self._ambient = each * draw["climate.ambient_c"][:, None]
        self._warm = self._ambient + draw["climate.warm_start_k"][:, None]
        dynamics = batch.expand("actuator_dynprm")
        self._node, self._to_housing = dynamics[:, :, drawn.AMBIENT], dynamics[:, :, drawn.RWH].copy()
        self.to_ambient = draw["drives.housing_to_ambient"] * spec.motor_array("housing_resistance_k_per_w")
        self.capacity = draw["drives.housing_capacity"] * spec.motor_array("housing_capacity_j_per_k")
        gear = batch.model.actuator_gear[:, 0]
        self._iron = draw["drives.iron_loss"] * spec.motor_array("iron_w_s2") * gear**2
        self.celsius = self._warm.copy()
        self.apply()

    def reset(self, rows: np.ndarray) -> None:
        """As at the start of the shift."""
        self.celsius[rows] = self._warm[rows]
        self.apply()

    def apply(self) -> None:
        """Tell MuJoCo's windings what they lie in."""
        self._node[:] = self.celsius

    def warm(self, rise: Floats, rubbed: Floats, turned: Floats, dt: float) -> None:
        """Let `dt` s pass; the windings keep their temperature when their ambient moves.

        Args:
            rise: (B, n) K, windings over housings, written.
            rubbed: (B, n) J, by friction.
            turned: (B, n) rad²/s, the joints' squared speed over that time.
            dt: s, far below the housings' minutes.
        """
        watts = rise / self._to_housing - (self.celsius - self._ambient) / self.to_ambient
        warming = (watts * dt + rubbed + self._iron * turned) / self.capacity
        self.celsius += warming
        rise -= warming
        self.apply()
