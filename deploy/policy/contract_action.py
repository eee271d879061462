"""Action of a contract: control mode, scale, offset and clip, and the drive gains of training."""

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from deploy.policy.contract_term import Clip, Count, NotNegatives, Numbers, Positive, Scales
from robots.motors.control_mode import ControlMode
from robots.motors.gains import Gains
from robots.strict import Strict

MODES = {
    "position_increment": ControlMode.POSITION,
    "position": ControlMode.POSITION,
    "velocity": ControlMode.VELOCITY,
    "torque": ControlMode.TORQUE,
}
"""Control mode of the drives for each mode of an action."""


class ActionSpec(Strict):
    """Meaning of an action.

    Attributes:
        mode: "position_increment": the target moves by scale · clip(action) each policy step; "position": it is
            offset + scale · clip(action), rad; "velocity" and "torque": it is scale · clip(action), rad/s or N·m.
        size: numbers in an action, one for each joint.
        offset: (size,) rad, of "position" alone.
        scale: (size,) units of the target per unit of action.
        clip: bounds of the raw action; None: unbounded.
        change_max: (size,) units of the target: its largest change in one policy step; None: any. Not of
            "position_increment", where scale · clip is that bound.
        leash_rad: rad, largest distance of an incremented target from the smoother's setpoint.
        kp, kd: (size,) N·m/rad and N·m·s/rad, the drives' gains in training; None: those of the robot's own drives. Not
            of "torque", where both are 0. In "velocity" kp may be 0: such a joint, a wheel, holds no angle.
    """

    mode: Literal["position_increment", "position", "velocity", "torque"]
    size: Count
    offset: Numbers | None = None
    scale: Scales
    clip: Clip | None
    change_max: Annotated[Scales | None, Field(exclude_if=lambda change_max: change_max is None)] = None
    leash_rad: Positive | None = None
    kp: NotNegatives | None = None
    kd: Scales | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name in ("offset", "scale", "change_max", "kp", "kd"):
            if (numbers := getattr(self, name)) is not None and len(numbers) != self.size:
                raise ValueError(f"{name} has {len(numbers)} numbers, size is {self.size}")
        self._check_fields_of_mode()
        self._check_gains()
        return self

    def _check_fields_of_mode(self) -> None:
        """Refuse fields that belong to another mode, and modes without their fields."""
        needed = {"leash_rad": self.mode == "position_increment", "offset": self.mode == "position"}
        for name, meant in needed.items():
            if (getattr(self, name) is not None) != meant:
                raise ValueError(f"{name}: found {'none' if meant else 'one'} in mode {self.mode!r}")
        if self.change_max is not None and self.mode == "position_increment":
            raise ValueError("change_max: found one in mode 'position_increment', where scale bounds it")

    def _check_gains(self) -> None:
        if (self.kp is None) != (self.kd is None):
            raise ValueError("found one of kp and kd, expected both or none")
        if self.kp is not None and self.mode == "torque":
            raise ValueError("kp: found some in mode 'torque', expected none: they are 0")
        if 0.0 in (self.kp or ()) and self.mode != "velocity":
            raise ValueError(f"kp: found 0 in mode {self.mode!r}, expected above 0: drives follow angles")

    @property
    def control_mode(self) -> ControlMode:
        """Mode of the drives."""
        return MODES[self.mode]

    @property
    def gains(self) -> Gains | None:
        """Drive gains from training, or None for the robot's own."""
        return None if self.kp is None or self.kd is None else Gains(np.array(self.kp), np.array(self.kd))

    @property
    def bounds(self) -> tuple[float, float]:
        """Low and high bound of the raw action; infinite without `clip`."""
        return self.clip or (-math.inf, math.inf)
