"""Capabilities: parts that a robot may have beside joints, each optional on its own.

Safety checks, monitors, observation sources and log columns name the capabilities that they need; a robot gets those
whose needs it meets. No other code depends on the kind of robot.
"""

from typing import Literal, TypeVar

Capability = Literal[
    "tool", "workspace", "manipulability", "floating_base", "self_collision", "allowed_contact"
]
"""tool: a site or body with a pose of its own. workspace: bounds on the tool's position and speed. manipulability: a
least distance from singularities. floating_base: the robot stands on feet. self_collision: shapes kept apart.
allowed_contact: some may touch, with a limit of force."""

Part = TypeVar("Part")


def required(part: Part | None) -> Part:
    """Return an optional part that must be there (else RuntimeError).

    A part of a robot is there where a declaration names its capability as needed.
    """
    if part is None:
        raise RuntimeError(
            "an optional part was read where there is none: was its capability declared as needed?"
        )
    return part
