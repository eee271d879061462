"""The contract of a foreign policy as its owner writes it: in the policy's own order, words of the field, one TOML."""

import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from deploy.policy.contract import Hertz, Task
from deploy.policy.observation_terms import SIZE_MAX, Clip, Count, Name, Number, Positive, Source
from policies.importers.torch_files.network_settings import Network
from robots.errors import ContractError
from robots.strict import Strict, parse, refuse_open

NONE = "none"
"""Stands for nothing, said on purpose."""
CHARACTERS_MAX = 1 << 20


def _listed(value: object) -> object:
    if value == NONE:
        return ()
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _nothing(value: object) -> object:
    return None if value == NONE else value


Given = Annotated[tuple[Number, ...], Field(max_length=SIZE_MAX), BeforeValidator(_listed)]
"""One number for all, a number for each, or "none": ()."""
Factors = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=SIZE_MAX), BeforeValidator(_listed)]
Bounds = Annotated[Clip | None, BeforeValidator(_nothing)]


class TermDraft(Strict):
    """One part of the observation, as the policy expects it: (reading - offset) · multiply, clipped.

    Attributes:
        name: unique. source: a word of `deploy.policy.observation_terms.Source`.
        offset: units of the source. multiply: per unit.
        clip: bounds; clip_first: whether they hold before multiplying, asked for where it matters.
        history: readings kept. period_s: s, of gait_phase.
    """

    name: Name
    source: Source
    offset: Given
    multiply: Factors
    clip: Bounds
    clip_first: bool | None = None
    history: Count
    period_s: Positive | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.clip is not None and set(self.multiply) != {1.0}:
            if self.clip_first is None:
                raise ValueError(
                    f"observation {self.name!r}: clip_first: missing: clip comes before multiply, or after"
                )
            if self.clip_first and len(set(self.multiply)) > 1:
                raise ValueError(
                    f"observation {self.name!r}: clip_first: true, expected one multiply for all numbers"
                )
        return self


class ActionDraft(Strict):
    """What an action does: "position", target = offset + multiply · clip(action); increments as in `ActionSpec`."""

    mode: Literal["position", "position_increment"]
    offset: Given
    multiply: Factors
    clip: Bounds
    leash_rad: Positive | None = None
    kp: Given
    kd: Given


class Draft(Strict):
    """Everything that the policy's own file may not say.

    Attributes:
        robot: name of the robot. task: what it is asked to do.
        policy_hz: Hz, how often it is asked.
        joint_names: joints in the policy's order: the robot's, and others that it observes.
        action_joints: those that it moves, the robot's, in the order of its action; None: all, in the same order.
        layout: with a history, whether the readings of each term stand together, or those of each time.
        frames: with a history, in which order. fill: what stands there before the first.
        observation: in the policy's order. action: what it does. network: what a file of weights does not say.
    """

    robot: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    task: Task
    policy_hz: Hertz
    joint_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)]
    action_joints: Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)] | None = None
    layout: Literal["by_term", "by_time"] | None = None
    frames: Literal["oldest_first", "newest_first"] | None = None
    fill: Literal["first", "zeros"] | None = None
    observation: Annotated[tuple[TermDraft, ...], Field(min_length=1, max_length=SIZE_MAX)]
    action: ActionDraft
    network: Network = Network()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if max(term.history for term in self.observation) == 1:
            return self
        for name in ("layout", "frames", "fill"):
            if getattr(self, name) is None:
                raise ValueError(f"{name}: missing: needed where a term has a history")
        if self.layout == "by_time" and len({term.history for term in self.observation}) > 1:
            raise ValueError("layout: found by_time, expected the same history for every term")
        return self


def read_draft(path: Path) -> Draft:
    """Read the contract's TOML.

    Raises:
        ContractError: one line for each field that is wrong or still open.
    """
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text if len(text) <= CHARACTERS_MAX else "")
    except OSError as e:
        raise ContractError(
            f"{path}: cannot be read: {e.strerror}; policy-import --template writes it"
        ) from e
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise ContractError(f"{path}: not valid TOML: {e}") from e
    refuse_open(data, str(path), ContractError)
    return parse(data, Draft, source=str(path), error=ContractError)
