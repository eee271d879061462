"""Terms of an observation: source, frame, unit, offset, scale, clip and history of each."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from deploy.sources.source import Frame, GaitLayout
from robots.strict import Strict

SIZE_MAX = 4096  # numbers in one observation: a bound on memory, far above any policy here


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
NotNegative = Annotated[float, Field(strict=True, ge=0)]
NotNegatives = Annotated[tuple[NotNegative, ...], Field(min_length=1, max_length=SIZE_MAX)]
Clip = Annotated[tuple[Number, Number], AfterValidator(_ordered)]


ONE_LEG = (0.0,)
"""Offsets of a gait whose phase is that of one leg."""
SINES_FIRST: GaitLayout = "sin_cos"


class Term(Strict):
    """One part of the observation: clip((reading - offset) / scale), with its history.

    Attributes:
        name: unique in the contract.
        source: name of an observation source of the robot or the task.
        frame: "joint", in the order of `joint_names`, "world", "base", "sensor" or "clock".
        unit: of the source, before scaling.
        size: numbers in one reading.
        offset: (size,) units; None: nothing is taken away.
        scale: (size,) units for each unit of observation.
        clip: bounds after scaling.
        history: readings kept, oldest first.
        fill: readings before the first one: "first" repeats that one, "zeros".
        period_s: s, of gait_phase alone.
        phase_offsets: turns by which each leg is ahead of the gait's phase, of gait_phase alone; by default one leg.
        layout: order of its sines and cosines, of gait_phase alone.
    """

    name: Name
    source: Name
    frame: Frame
    unit: Name
    size: Count
    offset: Numbers | None = None
    scale: Scales
    clip: Clip | None = None
    history: Count = 1
    fill: Literal["first", "zeros"] = "first"
    period_s: Positive | None = None
    phase_offsets: Annotated[Numbers, Field(exclude_if=lambda turns: turns == ONE_LEG)] = ONE_LEG
    layout: Annotated[GaitLayout, Field(exclude_if=lambda layout: layout == SINES_FIRST)] = SINES_FIRST

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, numbers in (("scale", self.scale), ("offset", self.offset)):
            if numbers is not None and len(numbers) != self.size:
                raise ValueError(
                    f"term {self.name!r}: {name} has {len(numbers)} numbers, size is {self.size}"
                )
        if (self.period_s is not None) != (self.source == "gait_phase"):
            raise ValueError(
                f"term {self.name!r}: period_s: found {self.period_s or 'none'}, expected"
                f" {'s of one gait' if self.source == 'gait_phase' else 'it of gait_phase alone'}"
            )
        if self.phase_offsets != ONE_LEG and self.source != "gait_phase":
            raise ValueError(
                f"term {self.name!r}: phase_offsets: found {list(self.phase_offsets)}, expected them of gait_phase"
                " alone"
            )
        if self.layout != SINES_FIRST and self.source != "gait_phase":
            raise ValueError(
                f"term {self.name!r}: layout: found {self.layout!r}, expected it of gait_phase alone"
            )
        return self
