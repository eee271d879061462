"""The words of an observation: what may be measured, in which frame and unit, and what a term makes of it."""

from typing import Annotated, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from robots.sensors import Kind
from robots.strict import Strict

SIZE_MAX = 4096  # numbers in one observation: a bound on memory, far above any policy here

Source = Literal[
    "joint_position",
    "joint_velocity",
    "tool_position",
    "goal_position",
    "goal_from_tool",
    "goal_torque",
    "target_offset",
    "last_action",
    "base_angular_velocity",
    "base_linear_velocity",
    "base_orientation",
    "projected_gravity",
    "velocity_command",
    "gait_phase",
]
Frame = Literal["joint", "world", "base", "clock"]


class Reading(NamedTuple):
    """What a source gives.

    Attributes:
        frame, unit: of its numbers.
        size: how many; None: one for each joint.
        sensor: the kind it needs.
        stands: whether only a robot that stands fixed has it, or only one with a base; None: every robot.
    """

    frame: Frame
    unit: str
    size: int | None = None
    sensor: Kind = "encoder"
    stands: bool | None = None


READINGS: dict[Source, Reading] = {
    "joint_position": Reading("joint", "rad"),
    "joint_velocity": Reading("joint", "rad/s"),
    "tool_position": Reading("world", "m", 3, stands=True),
    "goal_position": Reading("world", "m", 3, "goal", stands=True),
    "goal_from_tool": Reading("world", "m", 3, "goal", stands=True),
    "goal_torque": Reading("joint", "N·m", None, "goal", stands=True),
    "target_offset": Reading("joint", "rad"),
    "last_action": Reading("joint", "1"),
    "base_angular_velocity": Reading("base", "rad/s", 3, "gyro", stands=False),
    "base_linear_velocity": Reading("base", "m/s", 3, "gyro", stands=False),
    "base_orientation": Reading("world", "1", 4, "gyro", stands=False),
    "projected_gravity": Reading("base", "1", 3, "gyro", stands=False),
    "velocity_command": Reading("base", "m/s, m/s, rad/s", 3, stands=False),
    "gait_phase": Reading("clock", "1", 2, stands=False),
}
"""goal_torque: joint torques of a spring of 1 N/m that pulls the tool to the goal. base_orientation: quat_wxyz.
projected_gravity: the unit vector downwards. velocity_command: forwards, to the left, and turning to the left.
gait_phase: sine and cosine of 2π t / period_s."""


def _ordered(clip: tuple[float, float]) -> tuple[float, float]:
    if not clip[0] < clip[1]:
        raise ValueError(f"low {clip[0]} is not below high {clip[1]}")
    return clip


# JSON brings "3" and true where a number belongs: refuse both.
Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0)]
Count = Annotated[int, Field(strict=True, ge=1, le=SIZE_MAX)]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Numbers = Annotated[tuple[Number, ...], Field(min_length=1, max_length=SIZE_MAX)]
Scales = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=SIZE_MAX)]
Clip = Annotated[tuple[Number, Number], AfterValidator(_ordered)]


class Term(Strict):
    """One part of the observation: clip((reading - offset) / scale), the newest and those before it.

    Attributes:
        name: unique in the contract.
        source: what is measured.
        frame: "joint", in the order of `joint_names`, "world", "base" or "clock".
        unit: of the source, before scaling.
        size: numbers in one reading.
        offset: (size,) units; None: nothing is taken away.
        scale: (size,) units for each unit of observation.
        clip: bounds after scaling.
        history: readings kept, oldest first.
        fill: what stands for readings before the first: "first", that one, or "zeros".
        period_s: s, of gait_phase alone.
    """

    name: Name
    source: Source
    frame: Frame
    unit: Name
    size: Count
    offset: Numbers | None = None
    scale: Scales
    clip: Clip | None = None
    history: Count = 1
    fill: Literal["first", "zeros"] = "first"
    period_s: Positive | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, numbers in (("scale", self.scale), ("offset", self.offset)):
            if numbers is not None and len(numbers) != self.size:
                raise ValueError(
                    f"term {self.name!r}: {name} has {len(numbers)} numbers, size is {self.size}"
                )
        if (self.frame, self.unit) != (meant := READINGS[self.source][:2]):
            raise ValueError(
                f"term {self.name!r}: frame and unit of {self.source} are {self.frame!r} and {self.unit!r}, "
                f"expected {meant[0]!r} and {meant[1]!r}"
            )
        if (self.period_s is not None) != (self.source == "gait_phase"):
            raise ValueError(
                f"term {self.name!r}: period_s: found {self.period_s or 'none'}, expected"
                f" {'s of one gait' if self.source == 'gait_phase' else 'it of gait_phase alone'}"
            )
        return self
