"""Observations of a recipe: templates by name, lists of sources, and the physical maximum of every number."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from deploy.sources.maximum import Scale
from deploy.sources.source import ObservationSource
from robots.errors import ConfigError
from robots.spec import RobotSpec


class Template(NamedTuple):
    """Sources of an observation, in order.

    Attributes:
        size: numbers on the robots that it is made for; None: it fits robots of any number of joints.
        commanded: the command terms of the task follow.
    """

    sources: tuple[str, ...]
    size: int | None = None
    commanded: bool = False


TEMPLATES: Mapping[str, Template] = {
    "unit_24": Template(("joint_euler", "tool_position", "goal_position"), 24),
    "unit_42": Template(("joint_euler", "joint_rotation_rate", "tool_position", "goal_position"), 42),
    "planar_9": Template(("joint_position", "tool_position", "goal_position"), 9),
    "egocentric": Template(
        (
            *("base_linear_velocity", "base_pitch_roll", "base_pitch_roll_rate"),
            *("joint_position", "joint_velocity", "foot_contact", "base_height"),
        ),
        commanded=True,
    ),
}
"""unit_24, unit_42: an arm with six joints, without and with speeds. planar_9: a planar arm with three joints.
egocentric: a robot that walks, without its place and heading in the world; terms are grouped by quantity."""


def observation_sources(
    observation: str | Sequence[str],
    known: Mapping[str, ObservationSource],
    spec: RobotSpec,
    origin: str,
    command: tuple[str, ...],
) -> tuple[str, ...]:
    """Return the names of the sources of a template, or of a list of sources.

    Args:
        observation: name of a template, or names of sources.
        known: sources of robot and task, by name.
        spec: the robot.
        origin: file and field, for errors.
        command: command terms of the task; empty if it has none.

    Raises:
        ConfigError: no such template or source, a source twice or without what it needs, a template for robots
            with more or fewer joints, or one for commands and a task without any.
    """
    template = (
        Template(tuple(observation)) if not isinstance(observation, str) else TEMPLATES.get(observation)
    )
    if template is None:
        raise ConfigError(
            f"{origin}: found {observation!r}, expected a list of sources, or one of {', '.join(TEMPLATES)}"
        )
    names = (*template.sources, *(command if template.commanded else ()))
    for name in names:
        if name not in known:
            raise ConfigError(f"{origin}: found {name!r}, expected sources among {', '.join(known)}")
        if names.count(name) > 1:
            raise ConfigError(f"{origin}: found {name!r} {names.count(name)} times, expected once")
        if missing := known[name].missing(spec):
            raise ConfigError(f"{origin}: {name} needs {missing}")
    if template.commanded and not command:
        raise ConfigError(f"{origin}: found {observation!r}, expected it with a task that has command terms")
    count = sum(known[name].count(spec) for name in names)
    if template.size not in (None, count):
        raise ConfigError(
            f"{origin}: {observation!r} has {count} numbers on {spec.name}, expected {template.size}"
        )
    return names


def physical_maxima(name: str, source: ObservationSource, scale: Scale, origin: str) -> tuple[float, ...]:
    """Return the physical maximum of each number of a source.

    Raises:
        ConfigError: one is infinite or not above 0.
    """
    value = np.asarray(source.maximum.of(scale), dtype=float)
    count = source.count(scale.spec)
    if source.each == "joint":
        value = value.reshape(-1, 1)
    maxima = np.broadcast_to(value, (count // source.size, source.size)).ravel()
    if not (np.isfinite(maxima) & (maxima > 0.0)).all():
        raise ConfigError(
            f"{origin}: {name}: {source.maximum.meaning}: found {maxima.tolist()}, expected finite numbers above 0"
        )
    return tuple(maxima.tolist())
