"""Options of deploy-run: speed, and the seed or draw of a robot."""

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robots.distributions import load_distributions
from robots.draws import Draw, load_draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED = 7
SPEED_MIN, SPEED_MAX = 0.1, 1000.0
"""Bounds of --speed: below, a stop, which takes half a second of robot time, would keep Ctrl-C waiting."""


def speed_factor(speed: str) -> float:
    """Return robot time divided by wall time, a factor within bounds; infinite for `max`.

    Raises:
        ConfigError: it is neither `max` nor a factor within bounds.
    """
    if speed == "max":
        return math.inf
    try:
        factor = float(speed) if speed.isascii() else math.nan
    except ValueError:
        factor = math.nan
    if not SPEED_MIN <= factor <= SPEED_MAX:
        raise ConfigError(f"--speed {speed}: expected a factor from {SPEED_MIN:g} to {SPEED_MAX:g}, or max")
    return factor


class Source(NamedTuple):
    """Source of everything random.

    Attributes:
        text: the seed or draw, in words.
        draw: of the robot, if a file holds it. files: those that were read.
    """

    text: str
    seed: np.random.SeedSequence
    draw: Draw | None = None
    files: tuple[Path, ...] = ()


def random_source(spec: RobotSpec, seed: int | None, draw: str | None) -> Source:
    """Return the source of everything random.

    `draw` is the robot of a soak, as SEED:ROBOT or FILE:ROBOT; a robot drawn now has `seed`, None for `SEED`.

    Raises:
        ConfigError: a number out of bounds, a draw that cannot be read, or both seed and draw.
    """
    if draw is None:
        number = SEED if seed is None else seed
        if number < 0:
            raise ConfigError(f"--seed {number}: expected 0 or more")
        return Source(str(number), robot_seed(number, 0))
    match = re.fullmatch(r"(.+):([0-9]{1,9})", draw)
    if not match:
        raise ConfigError(f"--draw {draw}: expected SEED:ROBOT, or FILE:ROBOT of a soak's draws.json")
    if seed is not None:
        raise ConfigError(f"--draw {draw}: found --seed {seed} beside it, expected one of them")
    robot = int(match[2])
    if re.fullmatch(r"[0-9]{1,18}", match[1]):
        return Source(draw, robot_seed(int(match[1]), robot))
    path = Path(match[1])
    return Source(draw, *_stored(spec, draw, path, robot), (path,))


def _stored(spec: RobotSpec, draw: str, path: Path, robot: int) -> tuple[np.random.SeedSequence, Draw]:
    number, robots = load_draw(path, load_distributions(spec), spec)
    if robot >= robots.robots:
        raise ConfigError(
            f"--draw {draw}: found robot {robot}, expected one of the {robots.robots} from 0 on"
        )
    return robot_seed(number, robot), robots.robot(robot)
