"""Heat of an electric motor: a winding inside a housing inside a room.

    Cw dTw/dt = I² R0 (1 + α (Tw − T0)) − (Tw − Th)/Rwh
    Ch dTh/dt = (Tw − Th)/Rwh − (Th − Ta)/Rha

Source: two-node lumped model as in PR2's ethercat_hardware motor_heating_model (2010). In simulation the winding
node is MuJoCo's `dcmotor` and only `housing_step` runs; `temperatures` is the closed form that judges both.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorHeat:
    """One motor's constants.

    Attributes:
        resistance: ohm at `reference_c`. alpha: 1/K. reference_c: °C.
        winding_to_housing, housing_to_ambient: K/W. winding_capacity, housing_capacity: J/K.
    """

    resistance: float
    alpha: float
    reference_c: float
    winding_to_housing: float
    housing_to_ambient: float
    winding_capacity: float
    housing_capacity: float
