"""Action of a contract: control mode, scale, offset and clip, and the drive gains of training."""

import math
from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from deploy.policy.contract_term import Clip, Count, Numbers, Positive, Scales
from robots.motors.gains import Gains
from robots.strict import Strict


class ActionSpec(Strict):
    """Meaning of an action.

    Attributes:
        mode: "position_increment": the target moves by scale · clip(action) each policy step; "position": it is
            offset + scale · clip(action).
        size: numbers in an action, one for each joint.
        offset: (size,) rad, of "position" alone.
        scale: (size,) rad per unit of action.
        clip: bounds of the raw action; None: unbounded.
        leash_rad: rad, largest distance of an incremented target from the smoother's setpoint.
        kp, kd: (size,) N·m/rad and N·m·s/rad, the drives' gains in training; None: those of the robot's own drives.
    """

    mode: Literal["position_increment", "position"]
    size: Count
    offset: Numbers | None = None
    scale: Scales
    clip: Clip | None
    leash_rad: Positive | None = None
    kp: Scales | None = None
    kd: Scales | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name in ("offset", "scale", "kp", "kd"):
            if (numbers := getattr(self, name)) is not None and len(numbers) != self.size:
                raise ValueError(f"action {name} has {len(numbers)} numbers, size is {self.size}")
        here = {"leash_rad": self.leash_rad is not None, "offset": self.offset is not None}
        meant = {"leash_rad": self.mode == "position_increment", "offset": self.mode == "position"}
        if wrong := [name for name in here if here[name] != meant[name]]:
            found = "none" if meant[wrong[0]] else "one"
            raise ValueError(f"action {wrong[0]}: found {found} in mode {self.mode!r}")
        if (self.kp is None) != (self.kd is None):
            raise ValueError("action: found one of kp and kd, expected both or none")
        return self

    @property
    def gains(self) -> Gains | None:
        """Drive gains from training, or None for the robot's own."""
        return None if self.kp is None or self.kd is None else Gains(np.array(self.kp), np.array(self.kd))

    @property
    def bounds(self) -> tuple[float, float]:
        """Low and high bound of the raw action; infinite without `clip`."""
        return self.clip or (-math.inf, math.inf)
