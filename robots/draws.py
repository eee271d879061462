"""Draws: the real properties of robots, sampled from draws.toml or read from a file.

A draw is plain data: stored, it re-creates its robots exactly. The runtime in `deploy` never reads one.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import numpy as np
from pydantic import Field

from robots.arrays import Floats, Ints
from robots.distributions import Distributions, check_transport
from robots.errors import ConfigError
from robots.spans import Quantity
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_json_file

FILE_MAX = 1 << 29
"""Characters of a stored draw: 3 to 10 thousand for each robot."""


class Draw(dict[str, Floats]):
    """Real properties of B robots: numbers (B, ...) by name, as in `draw["links.mass"]`.

    The shape after B is that of the quantity's `each`.
    """

    @property
    def robots(self) -> int:
        """B."""
        return len(self["climate.ambient_c"])

    def replaced(self, values: Mapping[str, Floats | float]) -> "Draw":
        """Return the same robots with some numbers replaced; numpy broadcasts them."""
        new = {
            name: np.array(np.broadcast_to(x, self[name].shape), dtype=float) for name, x in values.items()
        }
        return Draw(self | new)

    def robot(self, row: int) -> "Draw":
        """Return one robot of the draw."""
        return self.rows(np.array([row]))

    def rows(self, rows: Ints) -> "Draw":
        """Return some robots of the draw, in the order of their rows."""
        return Draw({name: values[rows] for name, values in self.items()})

    def to_json(self, seed: int, distributions: Distributions, spec: RobotSpec) -> str:
        """Return all of it as exact JSON, with the seed of everything else that is random and the undrawn values."""
        draw = {name: values.tolist() for name, values in self.items()}
        return json.dumps({"seed": seed, "robot": spec.digest, "fixed": distributions.fixed, "draw": draw})


def draw(distributions: Distributions, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> Draw:
    """Return one robot for each seed. Every quantity has its own random stream: a new quantity changes no other.

    The B seeds are those of `robots.randomness.robot_seed`.
    """
    spans = [(name, span, shape(quantity, spec)) for name, quantity, span in distributions.spans()]
    return Draw(
        {
            name: np.stack([span.sample(_stream(seed, name), each) for seed in seeds])
            for name, span, each in spans
        }
    )


def load_draw(path: Path, distributions: Distributions, spec: RobotSpec) -> tuple[int, Draw]:
    """Return the seed and robots that `Draw.to_json` stored; refuse (ConfigError) another robot's, or beyond bounds."""
    stored = parse(read_json_file(path, FILE_MAX), _Stored, source=str(path))
    _check_identity(stored, path, distributions, spec)
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
        check_transport(kind, sensor, float(slowest.max()), loss, str(path))
    return stored.seed, Draw(values)


class _Stored(Strict):
    """A stored draw; its arrays are checked one by one."""

    seed: Annotated[int, Field(ge=0)]
    robot: str
    fixed: dict[str, float | str]
    draw: dict[str, Any]


def _check_identity(stored: _Stored, path: Path, distributions: Distributions, spec: RobotSpec) -> None:
    """Refuse the draw of another robot, or with other undrawn values."""
    for field, found, expected in (
        ("robot", stored.robot, spec.digest),
        *((f"fixed.{name}", stored.fixed.get(name), value) for name, value in distributions.fixed.items()),
    ):
        if found != expected:
            raise ConfigError(
                f"{path}: {field}: found {found!r:.80}, expected {expected!r:.80} of {spec.folder}"
            )


def _numbers(data: object, quantity: Quantity, spec: RobotSpec, where: str) -> Floats:
    read = np.array(data, dtype=object)  # of text, numpy would give each item the room of the longest
    if not {*map(type, read.flat)} <= {int, float}:  # lists in it are rows of different lengths
        raise ConfigError(f"{where}: not an array of numbers: {data!r:.40}")
    values, expected = read.astype(np.float64), shape(quantity, spec)
    if not values.size or values.shape[1:] != expected or not values.ndim:
        raise ConfigError(
            f"{where}: found shape {values.shape}, expected (B, {', '.join(map(str, expected))})"
        )
    beyond = values[~((values >= quantity.low) & (values <= quantity.high))]
    if beyond.size:
        raise ConfigError(f"{where}: found {beyond[0]:g}, expected [{quantity.low:g}, {quantity.high:g}]")
    return values


def median_draw(distributions: Distributions, spec: RobotSpec, robots: int) -> Draw:
    """Return robots in the middle of every span."""
    return Draw(
        {
            name: np.full((robots, *shape(quantity, spec)), span.median)
            for name, quantity, span in distributions.spans()
        }
    )


def shape(quantity: Quantity, spec: RobotSpec) -> tuple[int, ...]:
    """Return the shape of one robot's numbers."""
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
