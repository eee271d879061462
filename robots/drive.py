"""A drive as robot.toml declares it, for a model that says nothing of its motors or drives them otherwise."""

from typing import Annotated

from pydantic import Field, PositiveFloat

from robots.strict import Strict


class Drive(Strict):
    """A motor behind a gear that follows position, speed and torque; gains and torque are those of the joint.

    Attributes:
        gear: turns of the motor for one of the joint.
        torque_constant: N·m/A of the motor, without its gear.
        resistance_ohm: of the winding at `reference_c`, °C. copper_per_k: 1/K, how it grows.
        winding_resistance_k_per_w: K/W, winding to housing.
        winding_capacity_j_per_k: J/K, the winding's time constant over the resistance before.
        supply_v: V, the most that the drive can put on its motor.
        kp, kd: N·m/rad and N·m·s/rad.
        torque_max: N·m, of joints for which the model has no range of torque.
        armature: kg·m² of the rotor, times gear², of joints for which the model has none. Without it a joint with play
            is so light that no stiff drive holds it still.
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
