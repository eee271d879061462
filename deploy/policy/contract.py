"""Contract of a policy: the meaning of its numbers, carried inside its ONNX file.

It is defined where it is used: `policies` writes it, `deploy` moves nothing without it.
"""

import math
from collections import Counter
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import ONE_LEG, SINES_FIRST, SIZE_MAX, Name, Numbers, Scales, Term
from deploy.sources.source import GaitLayout
from deploy.tasks.task import sources_of
from robots.errors import ConfigError, ContractError
from robots.strict import RobotName, Strict, parse, read_json

MEMORY_MAX = 1 << 16  # numbers of recurrent state of one robot
TEXT_MAX = 1 << 20  # characters of JSON

Hertz = Annotated[int, Field(strict=True, ge=1, le=100_000)]


class Observed(Strict):
    """Statistics of observations in training, history included; used by judge and doctor, not by the policy.

    Attributes:
        mean: (N,) after scaling. deviation: (N,) standard deviation, or a little more.
    """

    mean: Numbers
    deviation: Scales


class Contract(Strict):
    """Assumptions of a policy about the robot, its rates and its inputs.

    Attributes:
        robot_digest: `RobotSpec.digest` that the policy was trained with.
        joint_names: order of every joint vector.
        memory: M, numbers of recurrent state, which start at 0; 0 for a policy without memory.
        trained: provenance in free text: recipe, seed, versions.
        observed: None if unknown.
    """

    format: Literal[1] = 1
    robot: RobotName
    robot_digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    joint_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)]
    policy_hz: Hertz
    control_hz: Hertz
    task: Name
    observation: Annotated[tuple[Term, ...], Field(min_length=1, max_length=SIZE_MAX)]
    action: ActionSpec
    memory: Annotated[int, Field(strict=True, ge=0, le=MEMORY_MAX)] = 0
    trained: Annotated[dict[Name, str], Field(max_length=100)]
    observed: Observed | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._check_sources()
        times = Counter(term.name for term in self.observation)
        if twice := [name for name in times if times[name] > 1]:
            raise ValueError(f"observation: terms named twice: {', '.join(twice)}")
        if self.observation_size > SIZE_MAX:
            raise ValueError(f"observation: {self.observation_size} numbers, at most {SIZE_MAX}")
        gaits = [term for term in self.observation if term.period_s]
        if len(periods := {term.period_s for term in gaits if term.period_s}) > 1:
            raise ValueError(f"observation: period_s: found {sorted(periods)}, expected the same for all")
        if len(legs := {term.phase_offsets for term in gaits}) > 1:
            raise ValueError(f"observation: phase_offsets: found {sorted(legs)}, expected the same for all")
        if len(layouts := {term.layout for term in gaits}) > 1:
            raise ValueError(f"observation: layout: found {sorted(layouts)}, expected the same for all")
        sizes = {len(self.observed.mean), len(self.observed.deviation)} if self.observed else set()
        if wrong := sizes - {self.observation_size}:
            raise ValueError(f"observed: found {wrong.pop()} numbers, expected {self.observation_size}")
        if self.control_hz % self.policy_hz:
            raise ValueError(f"policy_hz {self.policy_hz} does not divide control_hz {self.control_hz}")
        return self

    def _check_sources(self) -> None:
        """Compare frame and unit of every term with those of its source."""
        try:
            sources = sources_of(self.task)
        except ConfigError as e:
            raise ValueError(str(e)) from e
        for term in self.observation:
            if (source := sources.get(term.source)) is None:
                raise ValueError(
                    f"term {term.name!r}: source: found {term.source!r}, expected one of {', '.join(sources)}"
                )
            if (term.frame, term.unit) != (source.frame, source.unit):
                raise ValueError(
                    f"term {term.name!r}: frame and unit of {term.source} are {term.frame!r} and {term.unit!r}, "
                    f"expected {source.frame!r} and {source.unit!r}"
                )

    @property
    def observation_size(self) -> int:
        """N, size of one observation, history included."""
        return sum(term.size * term.history for term in self.observation)

    @property
    def period_s(self) -> float:
        """s, period of the gait; infinite without a gait term."""
        return next((term.period_s for term in self.observation if term.period_s), math.inf)

    @property
    def phase_offsets(self) -> tuple[float, ...]:
        """Turns by which each leg of the gait is ahead; of one leg without a gait term."""
        return next((term.phase_offsets for term in self.observation if term.period_s), ONE_LEG)

    @property
    def gait_layout(self) -> GaitLayout:
        """Order of the sines and cosines of the gait's phases."""
        return next((term.layout for term in self.observation if term.period_s), SINES_FIRST)

    @property
    def action_size(self) -> int:
        """A, size of one action."""
        return self.action.size

    def to_json(self) -> str:
        """Return JSON; every number reads back to the same bits."""
        return self.model_dump_json()

    @classmethod
    def from_json(cls, text: str, source: str) -> Self:
        """Read the JSON of `to_json`; `source` names the file in error messages.

        Raises:
            ContractError: one line for each field that is wrong.
        """
        return parse(
            read_json(text, source, TEXT_MAX, ContractError), cls, source=source, error=ContractError
        )
