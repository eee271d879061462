"""Candidates of a search, and cases: candidates in files, which are tried again after every change."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from deploy.telemetry.output_files import replacing
from eval.attack.adversaries import ADVERSARIES
from eval.attack.trained_gains import TrainedGains
from eval.attack.weights import WEIGHTS, Weights
from eval.judge.monitors import NAMES
from robots.errors import ConfigError
from robots.motors.control_mode import ControlModeName
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_json_file

CHARACTERS_MAX = 1 << 16
Numbers = Annotated[tuple[float, ...], Field(min_length=1)]


class Candidate(NamedTuple):
    """A policy and the robots that it moves.

    Attributes:
        adversary: name in the library. seed: of the draws, noise and faults.
    """

    adversary: str
    weights: Weights
    seed: int


class Block(NamedTuple):
    """Policies of one adversary, one for each robot of a shard.

    Attributes:
        rows: weights of each robot's policy. seed: of the robots.
    """

    adversary: str
    rows: tuple[Weights, ...]
    seed: int

    def candidate(self, robot: int) -> Candidate:
        """Return the candidate that a robot tries."""
        return Candidate(self.adversary, self.rows[robot], self.seed)


class Case(Strict):
    """One file of a regression suite: what an attack found.

    Attributes:
        robot: name of a shipped robot, or a folder. mode: in which drives follow the policy.
        faults: names of fault classes, of which one is injected into each robot.
        gains: kp and kd of the drives; None for their own, or those of the weights of a pushed arm.
        loaded: robots are those of `loaded_robots`, else those that a soak of the seed draws.
        monitor: whose margin was the least. worst: its highest ratio when the case was found.
        adversary, seed, weights: of the candidate. A pushed arm is chosen from its seed again: with other `draws.toml`
            or another rule it is another arm.
    """

    format: Literal[1] = 1
    robot: str
    mode: ControlModeName
    faults: tuple[str, ...]
    gains: Annotated[TrainedGains | None, Field(exclude_if=lambda gains: gains is None)] = None
    loaded: Annotated[bool, Field(exclude_if=lambda loaded: not loaded)] = False
    monitor: str
    worst: float | None
    adversary: str
    seed: Annotated[int, Field(ge=0)]
    weights: dict[str, Numbers]

    @property
    def candidate(self) -> Candidate:
        """Return the candidate."""
        return Candidate(self.adversary, self.weights, self.seed)

    def write(self, path: Path) -> None:
        """Write the file of the case."""
        with replacing(path) as file:
            file.write_text(self.model_dump_json() + "\n", encoding="utf-8")


def read_case(path: Path) -> Case:
    """Read the file of a case.

    Raises:
        ConfigError: naming the file and the field.
    """
    case = parse(read_json_file(path, CHARACTERS_MAX), Case, source=str(path))
    known = {"adversary": (case.adversary, tuple(ADVERSARIES)), "monitor": (case.monitor, NAMES)}
    for field, (found, names) in known.items():
        if found not in names:
            raise ConfigError(f"{path}: {field}: found {found!r:.80}, expected one of {', '.join(names)}")
    return case


def check_weights(candidate: Candidate, spec: RobotSpec, source: str) -> None:
    """Refuse weights that are not those of the candidate's adversary, or out of the bounds of a search.

    Raises:
        ConfigError: naming the source, the weight, what was found and what was expected.
    """
    expected = ADVERSARIES[candidate.adversary].first(spec.n)
    if candidate.weights.keys() != expected.keys():
        found = ", ".join(candidate.weights)
        raise ConfigError(f"{source}: weights: found {found!r:.200}, expected {', '.join(expected)}")
    for name, values in candidate.weights.items():
        kind = WEIGHTS[name]
        if len(values) != (size := kind.size(spec.n)):
            raise ConfigError(f"{source}: weights.{name}: found {len(values)} numbers, expected {size}")
        if not all(kind.low <= x <= kind.high for x in values):
            raise ConfigError(
                f"{source}: weights.{name}: found {min(values):g} to {max(values):g}, expected {kind.low:g} to"
                f" {kind.high:g}"
            )
        if kind.whole and not all(x.is_integer() for x in values):
            raise ConfigError(f"{source}: weights.{name}: found {values[0]:g}, expected a whole number")
