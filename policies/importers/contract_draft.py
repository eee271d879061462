"""Schema of the TOML in which a user describes an imported policy, in the policy's own joint order."""

import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from deploy.policy.contract import Hertz
from deploy.policy.contract_term import SIZE_MAX, Clip, Count, Name, Number, Positive
from policies.importers.torch_files.network_settings import NetworkSettings
from robots.errors import ContractError
from robots.strict import Strict, parse, reject_placeholders

NONE = "none"
"""Explicit absence of a value in the TOML."""
CHARACTERS_MAX = 1 << 20


def _as_tuple(value: object) -> object:
    if value == NONE:
        return ()
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _word_none_to_null(value: object) -> object:
    return None if value == NONE else value


Values = Annotated[tuple[Number, ...], Field(max_length=SIZE_MAX), BeforeValidator(_as_tuple)]
"""One number for all, one per element, or "none": ()."""
PositiveValues = Annotated[
    tuple[Positive, ...], Field(min_length=1, max_length=SIZE_MAX), BeforeValidator(_as_tuple)
]
OptionalClip = Annotated[Clip | None, BeforeValidator(_word_none_to_null)]


class TermDraft(Strict):
    """One term of the observation: (reading - offset) · multiply, clipped.

    Attributes:
        name: unique name. source: an observation source of the robot or the task.
        offset: in units of the source. multiply: factors per unit.
        clip: (low, high). clip_first: True if clipped before multiplied; required where it makes a difference.
        history: number of readings kept. period_s: s, period of gait_phase.
    """

    name: Name
    source: Name
    offset: Values
    multiply: PositiveValues
    clip: OptionalClip
    clip_first: bool | None = None
    history: Count
    period_s: Positive | None = None

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

    mode: Literal["position", "position_increment"]
    offset: Values
    multiply: PositiveValues
    clip: OptionalClip
    leash_rad: Positive | None = None
    kp: Values
    kd: Values


class ContractDraft(Strict):
    """Contract of an imported policy in the policy's own order.

    Attributes:
        robot: name of the robot. task: name of its task.
        policy_hz: Hz, rate of the policy.
        joint_names: observed joints in the policy's order: the robot's, and possibly others.
        action_joints: the robot's joints in the order of the action; None if all in the order of `joint_names`.
        layout: with a history, readings grouped by term or by time.
        frames: with a history, their order in time. fill: values before the first reading.
        observation: terms in the policy's order. action: the action. network: settings missing in a weights file.
    """

    robot: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    task: Name
    policy_hz: Hertz
    joint_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)]
    action_joints: Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)] | None = None
    layout: Literal["by_term", "by_time"] | None = None
    frames: Literal["oldest_first", "newest_first"] | None = None
    fill: Literal["first", "zeros"] | None = None
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
    """Read the contract's TOML.

    Raises:
        ContractError: one line per field that is wrong or still "?".
    """
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text if len(text) <= CHARACTERS_MAX else "")
    except OSError as e:
        raise ContractError(
            f"{path}: cannot be read: {e.strerror}; create it with policy-import --template"
        ) from e
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise ContractError(f"{path}: not valid TOML: {e}") from e
    reject_placeholders(data, str(path), ContractError)
    return parse(data, ContractDraft, source=str(path), error=ContractError)
