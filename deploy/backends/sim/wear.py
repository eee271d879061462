"""What months do to the joints of B robots, in hours."""

from typing import NamedTuple

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim import drawn
from deploy.backends.sim.anatomy import Anatomy
from deploy.stage import Stage
from robots import distributions
from robots.arrays import Floats
from robots.draws import Draw

TWICE_K = 10.0
"""K that halve a life. Source: Arrhenius' law as the rule of thumb of Montsinger (1930)."""
LEAST = 0.05
"""Share of its torque constant that a magnet keeps, whatever it has lived through."""
MOST, MOST_PLAY_RAD, MOST_SLIP_RAD = 20.0, 0.05, 0.1
"""Factor of friction, play and encoder's error that nothing grows beyond: as far as a new joint can be drawn."""


class Worn(NamedTuple):
    """What the joints have become, each (B, n): two factors of the robot as drawn, its play and its encoder's error."""

    friction: Floats
    backlash_rad: Floats
    encoder_rad: Floats
    torque_constant: Floats


class Wear(Stage):
    """`life` is how often a joint has lived its life: travel, counted double for each 10 K that its winding is warmer.

    All that wears grows in proportion to it, up to what a joint can be.
    """

    carried = ("life",)

    def __init__(self, wear: distributions.Wear, batch: Batch, anatomy: Anatomy, draw: Draw) -> None:
        """Read what wears; every joint begins new."""
        self._wear, self._draw = wear, draw
        self._dofs, self._play = anatomy.dofs, anatomy.play
        self._loss, self._range = batch.expand("dof_frictionloss"), batch.expand("jnt_range")
        self._constant = batch.expand("actuator_gainprm")[:, :, drawn.K]
        self._new_loss, self._new_constant = self._loss[:, self._dofs], self._constant.copy()
        self.friction, self.constant = self._new_loss.copy(), self._constant.copy()
        self.life = np.zeros_like(self.friction)
        self.encoder_rad = np.zeros_like(self.friction)

    def reset(self, rows: np.ndarray) -> None:
        """New joints for robots `rows`."""
        self.life[rows] = 0.0
        self.apply()

    def age(self, travel: Floats, winding_c: Floats) -> None:
        """Live through `travel` (B, n) rad at `winding_c` (B, n) °C."""
        hastened = np.exp2((winding_c - self._wear.life_c) / TWICE_K)
        self.life += travel / self._wear.life_rad * hastened
        self.apply()

    def worn(self) -> Worn:
        """What the joints have become."""
        draw, life = self._draw, self.life
        return Worn(
            friction=np.minimum(1.0 + draw["wear.friction"] * life, MOST),
            backlash_rad=np.minimum(
                draw["joints.backlash_rad"] + draw["wear.backlash_rad"] * life, MOST_PLAY_RAD
            ),
            encoder_rad=np.clip(draw["wear.encoder_rad"] * life, -MOST_SLIP_RAD, MOST_SLIP_RAD),
            torque_constant=np.maximum(1.0 + draw["wear.torque_constant"] * life, LEAST),
        )

    def apply(self) -> None:
        """Write it into the model."""
        worn = self.worn()
        np.multiply(self._new_loss, worn.friction, out=self.friction)
        np.multiply(self._new_constant, worn.torque_constant, out=self.constant)
        self._loss[:, self._dofs], self._constant[:] = self.friction, self.constant
        self._range[:, self._play, 1] = 0.5 * worn.backlash_rad
        self._range[:, self._play, 0] = -0.5 * worn.backlash_rad
        self.encoder_rad[:] = worn.encoder_rad
