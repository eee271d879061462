"""Control modes of a drive: what it is told to follow."""

from enum import IntEnum
from typing import Annotated, Literal

from pydantic import Field

ControlModeName = Literal["position", "velocity", "torque"]
"""Name of a control mode in files."""


class ControlMode(IntEnum):
    """Quantity that a drive is told to follow; numbers for arrays (B,)."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2


UNITS = {ControlMode.POSITION: "rad", ControlMode.VELOCITY: "rad/s", ControlMode.TORQUE: "N·m"}
"""Unit of a target in each mode."""

ControlModes = Annotated[tuple[ControlModeName, ...], Field(min_length=1, max_length=3)]
