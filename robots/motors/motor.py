"""Thermal model of an electric motor: winding, housing, ambient air.

    Cw dTw/dt = I² R0 (1 + α (Tw − T0)) − (Tw − Th)/Rwh
    Ch dTh/dt = (Tw − Th)/Rwh − (Th − Ta)/Rha

Source: two-node lumped model as in PR2's ethercat_hardware motor_heating_model (2010). At a constant current the
copper loss is linear in the winding's temperature, so the whole system is linear and has a closed form, to which
simulations are compared.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorHeat:
    """Thermal constants of one motor.

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


def temperatures(heat: MotorHeat, current: float, ambient: float, t: float) -> tuple[float, float]:
    """Return °C of winding and housing, t s after a constant current, A, began to flow in a motor at `ambient`, °C."""
    loss = current**2 * heat.resistance
    inner, outer = 1.0 / heat.winding_to_housing, 1.0 / heat.housing_to_ambient
    # Rises above ambient, in W; the third row is the constant 1, for the terms that do not depend on them.
    power = np.array(
        [
            [loss * heat.alpha - inner, inner, loss * (1.0 + heat.alpha * (ambient - heat.reference_c))],
            [inner, -inner - outer, 0.0],
            [0.0, 0.0, 0.0],
        ]
    )
    capacity = np.array([heat.winding_capacity, heat.housing_capacity, 1.0])
    rise = expm(power / capacity[:, None] * t)[:2, 2]
    return ambient + float(rise[0]), ambient + float(rise[1])
