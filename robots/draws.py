"""The draw that one robot gets: what it really is.

A draw is plain data: stored, it re-creates its robot exactly. The runtime in `deploy` never sees one.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import numpy as np
from pydantic import Field

from robots.arrays import Floats
from robots.distributions import Distributions, Quantity, Span, check_journey
from robots.errors import ConfigError
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_json

FILE_MAX = 1 << 29
"""Characters of a stored draw: more than a soak may have robots."""


class Draw(Mapping[str, Floats]):
    """B robots as they really are: (B, ...) numbers by name, as in `draw["links.mass"]`."""

    def __init__(self, values: Mapping[str, Floats]) -> None:
        """Take the numbers; see `draw` and `load_draw` for where they come from."""
        self._values = dict(values)

    def __getitem__(self, name: str) -> Floats:
        """(B, ...) numbers; the shape behind B is that of the quantity's `each`."""
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        """Names."""
        return iter(self._values)

    def __len__(self) -> int:
        """How many quantities."""
        return len(self._values)

    @property
    def robots(self) -> int:
        """B."""
        return len(self["climate.ambient_c"])

    def replaced(self, values: Mapping[str, Floats | float]) -> "Draw":
        """The same robots but for some numbers, which numpy broadcasts."""
        new = {
            name: np.array(np.broadcast_to(x, self[name].shape), dtype=float) for name, x in values.items()
        }
        return Draw(dict(self) | new)

    def robot(self, row: int) -> "Draw":
        """One of them alone."""
        return Draw({name: values[row : row + 1] for name, values in self.items()})

    def to_json(self, seed: int, distributions: Distributions, spec: RobotSpec) -> str:
        """All of it, exactly, with the seed of everything else that is random, and what is the same for all."""
        draw = {name: values.tolist() for name, values in self.items()}
        return json.dumps({"seed": seed, "robot": spec.digest, "fixed": distributions.fixed, "draw": draw})


def draw(distributions: Distributions, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> Draw:
    """One robot for each seed. Every quantity has a stream of its own: a new one leaves the others as they were.

    Args:
        distributions: the spans.
        spec: how many joints and sensors there are.
        seeds: B seeds, as `robots.randomness.robot_seed` gives them.
    """
    return Draw(
        {
            name: np.stack([span.sample(_stream(seed, name), shape(quantity, spec)) for seed in seeds])
            for name, quantity, span in distributions.spans()
        }
    )


def load_draw(path: Path, distributions: Distributions, spec: RobotSpec) -> tuple[int, Draw]:
    """The seed and the robots that `Draw.to_json` stored.

    Raises:
        ConfigError: unreadable, another robot's, or outside what physics allows.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as e:
        raise ConfigError(f"{path}: cannot be read: {e}") from e
    stored = parse(read_json(text, str(path), FILE_MAX), _Stored, source=str(path))
    for field, found, expected in (
        ("robot", stored.robot, spec.digest),
        *((f"fixed.{name}", stored.fixed.get(name), value) for name, value in distributions.fixed.items()),
    ):
        if found != expected:
            raise ConfigError(
                f"{path}: {field}: found {found!r:.80}, expected {expected!r:.80} of {spec.folder}"
            )
    quantities = {name: quantity for name, quantity, _ in distributions.spans()}
    for name in sorted(stored.draw.keys() ^ quantities.keys()):
        raise ConfigError(f"{path}: {name}: {'unknown' if name in stored.draw else 'missing'}")
    values = {name: _numbers(stored.draw[name], q, spec, f"{path}: {name}") for name, q in quantities.items()}
    robots = {name: len(numbers) for name, numbers in values.items()}
    if len(set(robots.values())) > 1:
        raise ConfigError(f"{path}: found {robots} robots, expected the same for every quantity")
    for place, (kind, sensor) in enumerate(spec.sensors.items()):
        slowest = values["sensors.delay"][:, place] + values["sensors.jitter"][:, place]
        loss = float(values["sensors.loss"][:, place].max())
        check_journey(kind, sensor, float(slowest.max()), loss, str(path))
    return stored.seed, Draw(values)


class _Stored(Strict):
    """A stored draw; its arrays are looked at one by one."""

    seed: Annotated[int, Field(ge=0)]
    robot: str
    fixed: dict[str, float | str]
    draw: dict[str, Any]


def _numbers(data: object, quantity: Quantity, spec: RobotSpec, where: str) -> Floats:
    try:
        values = np.array(data, dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise ConfigError(f"{where}: not an array of numbers: {data!r:.40}") from e
    expected = shape(quantity, spec)
    if values.shape[1:] != expected or not len(values):
        raise ConfigError(
            f"{where}: found shape {values.shape}, expected (B, {', '.join(map(str, expected))})"
        )
    beyond = values[~((values >= quantity.low) & (values <= quantity.high))]
    if beyond.size:
        raise ConfigError(f"{where}: found {beyond[0]:g}, expected [{quantity.low:g}, {quantity.high:g}]")
    return values


def middle(distributions: Distributions, spec: RobotSpec, robots: int) -> Draw:
    """As many robots in the middle of every span, by its logarithm where it is drawn so."""
    return Draw(
        {
            name: np.full((robots, *shape(quantity, spec)), _mid(span))
            for name, quantity, span in distributions.spans()
        }
    )


def _mid(span: Span) -> float:
    return float(np.sqrt(span.low * span.high)) if span.log else (span.low + span.high) / 2


def shape(quantity: Quantity, spec: RobotSpec) -> tuple[int, ...]:
    """Of one robot's numbers."""
    shapes: dict[str, tuple[int, ...]] = {
        "": (),
        "direction": (3,),
        "horizontal": (2,),
        "joint": (spec.n,),
        "axis": (spec.n, 3),
        "sensor": (len(spec.sensors),),
        "channel": (sum(spec.channels.values()),),
    }
    return shapes[quantity.each]


def _stream(seed: np.random.SeedSequence, name: str) -> np.random.Generator:
    child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, crc32(name.encode())))
    return np.random.default_rng(child)
