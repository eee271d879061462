"""Wear of the joints of B robots: months of work, simulated in hours."""

from typing import NamedTuple

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.model.motor_parameters import TORQUE_CONSTANT
from deploy.backends.sim.model.plant_model import PlantModel
from deploy.stage import Stage
from robots import distributions
from robots.arrays import Floats
from robots.draws import Draw

HALF_LIFE_K = 10.0
"""K of winding temperature that halve a life. Source: Arrhenius' law as the rule of thumb of Montsinger (1930)."""
CONSTANT_MIN = 0.05
"""Smallest factor of the torque constant: the share of its magnetisation that a magnet always keeps."""
FRICTION_MAX, BACKLASH_MAX_RAD, ENCODER_MAX_RAD = 20.0, 0.05, 0.1
"""Largest factor of friction, backlash and encoder error: as far as a new joint can be drawn."""


class WornJoints(NamedTuple):
    """State of the joints, each (B, n): friction and torque constant as factors of the drawn ones."""

    friction: Floats
    backlash_rad: Floats
    encoder_rad: Floats
    torque_constant: Floats


class Wear(Stage):
    """All that wears grows in proportion to the share of life used, up to a bound.

    Attributes:
        life: (B, n) travel in lives of a joint, counted double for each 10 K that its winding is warmer.
        friction: (B, n) N·m. constant: (B, n) N·m/A. encoder_rad: (B, n) rad, error of the encoder.
    """

    carried = ("life",)

    def __init__(self, wear: distributions.Wear, batch: Batch, plant: PlantModel, draw: Draw) -> None:
        self._wear, self._draw = wear, draw
        self.dofs, self._backlash = plant.dofs, plant.backlash
        self._friction, self._range = batch.expand("dof_frictionloss"), batch.expand("jnt_range")
        self._constant = batch.expand("actuator_gainprm")[:, :, TORQUE_CONSTANT]
        self._new_friction, self._new_constant = self._friction[:, self.dofs], self._constant.copy()
        self.friction, self.constant = self._new_friction.copy(), self._constant.copy()
        self.life = np.zeros_like(self.friction)
        self.encoder_rad = np.zeros_like(self.friction)

    def reset(self, rows: np.ndarray) -> None:
        """Make the joints of robots `rows` new."""
        self.life[rows] = 0.0
        self.apply()

    def step(self, travel: Floats, winding_c: Floats) -> None:
        """Use up life by `travel` (B, n) rad at `winding_c` (B, n) °C."""
        acceleration = np.exp2((winding_c - self._wear.life_c) / HALF_LIFE_K)
        self.life += travel / self._wear.life_rad * acceleration
        self.apply()

    def worn(self) -> WornJoints:
        """Return the present state of the joints."""
        draw, life = self._draw, self.life
        backlash = draw["joints.backlash_rad"] + draw["wear.backlash_rad"] * life
        return WornJoints(
            friction=np.minimum(1.0 + draw["wear.friction"] * life, FRICTION_MAX),
            backlash_rad=np.minimum(backlash, BACKLASH_MAX_RAD),
            encoder_rad=np.clip(draw["wear.encoder_rad"] * life, -ENCODER_MAX_RAD, ENCODER_MAX_RAD),
            torque_constant=np.maximum(1.0 + draw["wear.torque_constant"] * life, CONSTANT_MIN),
        )

    def apply(self) -> None:
        """Write the present state into the model."""
        worn = self.worn()
        np.multiply(self._new_friction, worn.friction, out=self.friction)
        np.multiply(self._new_constant, worn.torque_constant, out=self.constant)
        self._friction[:, self.dofs], self._constant[:] = self.friction, self.constant
        self._range[:, self._backlash, 1] = 0.5 * worn.backlash_rad
        self._range[:, self._backlash, 0] = -0.5 * worn.backlash_rad
        self.encoder_rad[:] = worn.encoder_rad
