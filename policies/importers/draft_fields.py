"""Words of the field for what a policy observes, and the fields of a contract's TOML that they fill."""

from collections.abc import Sequence
from typing import Any

from deploy.policy.observation_terms import Source

SOURCES: dict[str, Source] = {
    "joint_pos": "joint_position",
    "joint_pos_rel": "joint_position",
    "dof_pos": "joint_position",
    "joint_vel": "joint_velocity",
    "joint_vel_rel": "joint_velocity",
    "dof_vel": "joint_velocity",
    "base_ang_vel": "base_angular_velocity",
    "base_lin_vel": "base_linear_velocity",
    "projected_gravity": "projected_gravity",
    "velocity_commands": "velocity_command",
    "velocity_command": "velocity_command",
    "actions": "last_action",
    "last_action": "last_action",
}
"""Where all agree. Positions of joints are differences from a default pose, whatever the word says of it."""


def said(**fields: Any) -> dict[str, Any]:
    """What a file says: None, what it does not, is left out."""
    return {name: value for name, value in fields.items() if value is not None}


def factors(numbers: Sequence[float] | None) -> float | list[float] | None:
    """One number for all or one for each; None where one is not positive: rounded away, or without meaning."""
    if numbers is None or min(numbers) <= 0:
        return None
    return numbers[0] if len(numbers) == 1 else list(numbers)


def gains(kp: Sequence[float] | None, kd: Sequence[float] | None) -> dict[str, list[float]]:
    """Both or none: exporters write 0 for drives that they cannot read."""
    if kp is None or kd is None or min(*kp, *kd) <= 0:
        return {}
    return {"kp": list(kp), "kd": list(kd)}


def term(name: str, word: str, pose: list[float] | None, **fields: Any) -> dict[str, Any]:
    """One part of the observation.

    Args:
        name: its own. word: that of the field for it.
        pose: (n,) rad, what joint positions are differences from.
        fields: what else is said.
    """
    source = SOURCES.get(word)
    offset = None if source is None else pose if source == "joint_position" else "none"
    return said(name=name, source=source, offset=offset, **fields)


def contract(observation: list[dict[str, Any]] | None, fill: str, **fields: Any) -> dict[str, Any]:
    """All that is said. Wherever these words are used, readings of each term stand together, oldest first.

    Args:
        observation: its terms.
        fill: what stands before the first reading.
        fields: what else is said.
    """
    terms = observation or []
    velocity = any(term.get("source") == "velocity_command" for term in terms)
    remembered = any(term.get("history", 1) > 1 for term in terms)
    history = {"layout": "by_term", "frames": "oldest_first", "fill": fill} if remembered else {}
    task = "velocity" if velocity else None
    return said(task=task, observation=observation, **history, **fields)
