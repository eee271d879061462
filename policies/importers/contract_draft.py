"""Schema of the TOML in which a user describes an imported policy, in the policy's own joint order."""

import os
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from deploy.policy.contract import Hertz
from deploy.policy.contract_term import (
    ONE_LEG,
    SINES_FIRST,
    SIZE_MAX,
    Clip,
    Count,
    Name,
    Number,
    Numbers,
    Positive,
)
from deploy.sources.source import GaitLayout
from policies.importers.torch_files.network_settings import NetworkSettings
from robots.errors import ContractError
from robots.strict import Strict, read_toml

NONE = "none"
"""Explicit absence of a value in the TOML."""
BYTES_MAX = 1 << 20


def _as_tuple(value: object) -> object:
    if value == NONE:
        return ()
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


Values = Annotated[tuple[Number, ...], Field(max_length=SIZE_MAX), BeforeValidator(_as_tuple)]
"""One number for all, one per element, or "none": ()."""
PositiveValues = Annotated[
    tuple[Positive, ...], Field(min_length=1, max_length=SIZE_MAX), BeforeValidator(_as_tuple)
]
Joints = Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)]
OptionalClip = Annotated[Clip | None, BeforeValidator(lambda value: None if value == NONE else value)]


class TermDraft(Strict):
    """One term of the observation: (reading - offset) · multiply, clipped; offset in units of the source.

    `clip_first` is required where it makes a difference, `period_s` (s), `phase_offsets` (turns, one for each leg) and
    `layout` for gait_phase only.
    """

    name: Name = Field(description="unique name; one such table per term, in the policy's order")
    source: Name = Field(description="one of the sources above")
    offset: Values = Field(description="subtracted from the reading; one number, one per element, or none")
    multiply: PositiveValues = Field(description="then multiplied; one number, or one per element")
    clip: OptionalClip = Field(description="[low, high] or none")
    clip_first: bool | None = Field(default=None, description="true: clip before multiply; false: after")
    history: Count = Field(
        description="number of readings, 1 for the newest only; gait_phase also needs period_s, s, gait period,"
        " phase_offsets, turns, if it has several legs, and layout, cos_sin or by_leg, if its sines do not come first"
    )
    period_s: Positive | None = None
    phase_offsets: Numbers = ONE_LEG
    layout: GaitLayout = SINES_FIRST

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.clip is not None and set(self.multiply) != {1.0}:
            if self.clip_first is None:
                raise ValueError(
                    f"observation {self.name!r}: clip_first: missing, expected true (clip before multiply) or false"
                )
            if self.clip_first and len(set(self.multiply)) > 1:
                raise ValueError(
                    f"observation {self.name!r}: clip_first: found true, expected one factor in multiply"
                )
        return self


class ActionDraft(Strict):
    """The action: for "position", target = offset + multiply · clip(action); increments as in `ActionSpec`."""

    mode: Literal["position", "position_increment"] = Field(
        description='"position" (target = offset + multiply * action) or "position_increment"'
    )
    offset: Values = Field(description="rad, joint positions at an action of 0; none for increments")
    multiply: PositiveValues = Field(description="rad per unit of action")
    clip: OptionalClip = Field(description="[low, high] of the raw action, or none")
    leash_rad: Positive | None = None
    kp: Values = Field(description="N·m/rad, drive gains in training; none: the robot's own")
    kd: Values = Field(description="N·m·s/rad")


class ContractDraft(Strict):
    """Contract of an imported policy in the policy's own order. Descriptions appear in the template.

    Attributes:
        joint_names: observed joints: the robot's, and possibly others.
        action_joints: None if all of them, in the order of `joint_names`.
        layout, frames, fill: required with a history.
        observation: terms in the policy's order. network: settings missing in a weights file.
    """

    robot: str = Field(pattern=r"^[A-Za-z0-9_-]{1,64}$", description="name of the robot")
    task: Name = Field(description="name of its task")
    policy_hz: Hertz = Field(description="Hz, rate of the policy")
    joint_names: Joints = Field(description="the robot's joints in the policy's order")
    action_joints: Joints | None = Field(
        default=None, description="those of joint_names that the action moves, in the order of the action"
    )
    layout: Literal["by_term", "by_time"] | None = Field(
        default=None, description='"by_term" or "by_time": readings grouped by term, or by time'
    )
    frames: Literal["oldest_first", "newest_first"] | None = Field(
        default=None, description='"oldest_first" or "newest_first"'
    )
    fill: Literal["first", "zeros"] | None = Field(
        default=None,
        description='"first" (repeat the first reading) or "zeros": values before the first reading',
    )
    observation: Annotated[tuple[TermDraft, ...], Field(min_length=1, max_length=SIZE_MAX)]
    action: ActionDraft
    network: NetworkSettings = NetworkSettings()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if max(term.history for term in self.observation) == 1:
            return self
        for name in ("layout", "frames", "fill"):
            if getattr(self, name) is None:
                raise ValueError(f"{name}: missing, required where a term has a history")
        if self.layout == "by_time" and len({term.history for term in self.observation}) > 1:
            raise ValueError("layout: found by_time, expected the same history for every term")
        return self


def read_draft(path: Path) -> ContractDraft:
    """Read the contract's TOML; ContractError has one line per field that is wrong or still "?"."""
    if not os.path.isfile(path):
        raise ContractError(f"{path}: cannot be read: no such file; create it with policy-import --template")
    if (size := path.stat().st_size) > BYTES_MAX:
        raise ContractError(f"{path}: found {size} bytes, expected a contract of at most {BYTES_MAX}")
    return read_toml(path, ContractDraft, ContractError)
