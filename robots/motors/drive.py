"""Drives of robot.toml, for a model without motors or with other actuators."""

from typing import Annotated

from pydantic import Field, PositiveFloat

from robots.strict import Strict


class Drive(Strict):
    """Motor with a gear that follows position, speed and torque; gains and torque are at the joint.

    Attributes:
        gear: turns of the motor for one turn of the joint.
        torque_constant: N·m/A of the motor, without its gear.
        resistance_ohm: of the winding at `reference_c`, °C. copper_per_k: 1/K, its growth with temperature.
        winding_resistance_k_per_w: K/W, winding to housing.
        winding_capacity_j_per_k: J/K, the winding's time constant divided by its thermal resistance.
        supply_v: V, the highest voltage of the motor.
        kp, kd: N·m/rad and N·m·s/rad.
        torque_max: N·m, for joints without a torque range in the model.
        armature: kg·m² of the rotor, times gear², for joints without one in the model. Without it a joint with play is
            so light that a stiff drive oscillates.
    """

    gear: PositiveFloat
    torque_constant: PositiveFloat
    resistance_ohm: PositiveFloat
    reference_c: Annotated[float, Field(ge=-50, le=300)]
    copper_per_k: Annotated[float, Field(ge=0)]
    winding_resistance_k_per_w: PositiveFloat
    winding_capacity_j_per_k: PositiveFloat
    supply_v: PositiveFloat
    kp: PositiveFloat
    kd: Annotated[float, Field(ge=0)]
    torque_max: PositiveFloat | None = None
    armature: PositiveFloat | None = None
