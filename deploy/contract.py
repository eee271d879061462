"""The policy contract: what the numbers of a policy mean, carried inside its ONNX file.

The side that consumes it owns it: `policies` writes it, `deploy` moves nothing without it.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from robots.errors import ContractError
from robots.sensors import Kind
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_json

CONTRACT_KEY = "firstshift.contract"
SIZE_MAX = 4096  # numbers in one observation: a bound on memory, far above any policy here
MEMORY_MAX = 1 << 16  # numbers that one robot's policy may remember
TEXT_MAX = 1 << 20  # characters of JSON

Source = Literal[
    "joint_position",
    "joint_velocity",
    "tool_position",
    "goal_from_tool",
    "goal_torque",
    "target_offset",
    "last_action",
]
# goal_torque: joint torques of a spring of 1 N/m that pulls the tool to the goal.
FRAME_AND_UNIT: dict[Source, tuple[str, str]] = {
    "joint_position": ("joint", "rad"),
    "joint_velocity": ("joint", "rad/s"),
    "tool_position": ("world", "m"),
    "goal_from_tool": ("world", "m"),
    "goal_torque": ("joint", "N·m"),
    "target_offset": ("joint", "rad"),
    "last_action": ("joint", "1"),
}


SENSED: dict[Source, Kind] = {"goal_from_tool": "goal", "goal_torque": "goal"}
"""Which sensor a source needs beyond those that every robot has."""


def _ordered(clip: tuple[float, float]) -> tuple[float, float]:
    if not clip[0] < clip[1]:
        raise ValueError(f"low {clip[0]} is not below high {clip[1]}")
    return clip


# JSON brings "3" and true where a number belongs: refuse both.
Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0)]
Count = Annotated[int, Field(strict=True, ge=1, le=SIZE_MAX)]
Hertz = Annotated[int, Field(strict=True, ge=1, le=100_000)]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Scales = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=SIZE_MAX)]
Clip = Annotated[tuple[Number, Number], AfterValidator(_ordered)]


class Term(Strict):
    """One part of the observation.

    Attributes:
        name: unique in the contract.
        source: what is measured.
        frame: "joint", in the order of `joint_names`, or "world".
        unit: of the source, before scaling.
        size: numbers in one reading.
        scale: (size,) units; observation = reading / scale.
        clip: bounds after scaling.
        history: readings kept, oldest first.
    """

    name: Name
    source: Source
    frame: Literal["joint", "world"]
    unit: Name
    size: Count
    scale: Scales
    clip: Clip | None = None
    history: Count = 1

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.scale) != self.size:
            raise ValueError(f"term {self.name!r}: scale has {len(self.scale)} numbers, size is {self.size}")
        if (self.frame, self.unit) != (meant := FRAME_AND_UNIT[self.source]):
            raise ValueError(
                f"term {self.name!r}: frame and unit of {self.source} are {self.frame!r} and {self.unit!r}, "
                f"expected {meant[0]!r} and {meant[1]!r}"
            )
        return self


class ActionSpec(Strict):
    """What an action does.

    Attributes:
        mode: "position_increment": the target moves by scale · clip(action) each policy step.
        size: numbers in an action, one for each joint.
        scale: (size,) rad per unit of action.
        clip: bounds of the raw action.
        leash_rad: rad, how far the target may run ahead of the smoother's setpoint.
    """

    mode: Literal["position_increment"]
    size: Count
    scale: Scales
    clip: Clip
    leash_rad: Positive

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.scale) != self.size:
            raise ValueError(f"action scale has {len(self.scale)} numbers, size is {self.size}")
        return self


class Observed(Strict):
    """What the numbers of observations were like in training, history included: for whoever judges, not for the policy.

    Attributes:
        mean: (N,) after scaling. deviation: (N,) standard deviation, or a little more.
    """

    mean: Annotated[tuple[Number, ...], Field(min_length=1, max_length=SIZE_MAX)]
    deviation: Scales


class Contract(Strict):
    """Everything a policy assumes about the robot, its rates and its inputs.

    Attributes:
        robot_digest: `RobotSpec.digest` that the policy was trained with.
        joint_names: order of every joint vector.
        memory: M, how many numbers a policy hands on from each of its steps to the next; 0 when it begins. None of its
            own: 0.
        trained: provenance in free words: recipe, seed, versions.
        observed: None where nobody wrote it down.
    """

    format: Literal[1] = 1
    robot: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    robot_digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    joint_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)]
    policy_hz: Hertz
    control_hz: Hertz
    task: Literal["reach"]
    observation: Annotated[tuple[Term, ...], Field(min_length=1, max_length=SIZE_MAX)]
    action: ActionSpec
    memory: Annotated[int, Field(strict=True, ge=0, le=MEMORY_MAX)] = 0
    trained: Annotated[dict[Name, str], Field(max_length=100)]
    observed: Observed | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        times = Counter(term.name for term in self.observation)
        if twice := [name for name in times if times[name] > 1]:
            raise ValueError(f"observation: terms named twice: {', '.join(twice)}")
        if self.observation_size > SIZE_MAX:
            raise ValueError(f"observation: {self.observation_size} numbers, at most {SIZE_MAX}")
        sizes = {len(self.observed.mean), len(self.observed.deviation)} if self.observed else set()
        if wrong := sizes - {self.observation_size}:
            raise ValueError(f"observed: found {wrong.pop()} numbers, expected {self.observation_size}")
        if self.control_hz % self.policy_hz:
            raise ValueError(f"policy_hz {self.policy_hz} does not divide control_hz {self.control_hz}")
        return self

    @property
    def observation_size(self) -> int:
        """N, numbers in one observation, history included."""
        return sum(term.size * term.history for term in self.observation)

    @property
    def action_size(self) -> int:
        """A, numbers in one action."""
        return self.action.size

    def to_json(self) -> str:
        """JSON in which every number reads back to the same bits."""
        return self.model_dump_json()

    @classmethod
    def from_json(cls, text: str, source: str) -> Self:
        """Read what `to_json` wrote; `source` names the file in messages.

        Raises:
            ContractError: one line for each field that is wrong.
        """
        return parse(
            read_json(text, source, TEXT_MAX, ContractError), cls, source=source, error=ContractError
        )


def check_contract(contract: Contract, spec: RobotSpec, source: str) -> None:
    """Compare what a policy assumes with the robot it is to move.

    Raises:
        ContractError: one line for each field: found, expected.
    """
    if wrong := list(_mismatches(contract, spec)):
        raise ContractError("\n".join(f"{source}: {line}" for line in wrong))


def _mismatches(contract: Contract, spec: RobotSpec) -> Iterator[str]:
    if contract.robot != spec.name:
        yield f"robot: found {contract.robot!r}, expected {spec.name!r}"
        return  # nothing else can be expected to agree
    yield from _joints(contract.joint_names, spec)
    if contract.robot_digest != spec.digest:
        yield f"robot_digest: found {contract.robot_digest}, expected {spec.digest} of {spec.folder}"
    if contract.control_hz != spec.rates.control_hz:
        yield f"control_hz: found {contract.control_hz} Hz, expected {spec.rates.control_hz} Hz"
    yield from _terms(contract, spec)


def _joints(found: tuple[str, ...], spec: RobotSpec) -> Iterator[str]:
    if found == spec.joint_names:
        return
    permuted = sorted(found) == sorted(spec.joint_names)
    what = "the right joints in another order: " if permuted else ""
    yield f"joint_names: {what}found {_listed(found)}, expected {_listed(spec.joint_names)}"


def _listed(names: tuple[str, ...]) -> str:
    return (
        f"[{', '.join(names)}]"
        if len(names) < 100 and all(map(str.isprintable, names))
        else repr(names)[:400]
    )


def _terms(contract: Contract, spec: RobotSpec) -> Iterator[str]:
    joints = ("joint_position", "joint_velocity", "goal_torque", "target_offset")
    size = {"last_action": contract.action_size, **dict.fromkeys(joints, spec.n)}
    for term in contract.observation:
        if term.size != (expected := size.get(term.source, 3)):
            yield f"observation.{term.name}.size: found {term.size}, expected {expected} for {term.source}"
        if (sensor := SENSED.get(term.source, "encoder")) not in spec.sensors:
            yield (
                f"observation.{term.name}.source: {term.source} needs a sensor of kind {sensor}; {spec.name} has"
                f" {', '.join(spec.sensors)}"
            )
    if contract.action_size != spec.n:
        yield f"action.size: found {contract.action_size}, expected {spec.n}, one for each joint"
