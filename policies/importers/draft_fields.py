"""Fields of the contract's TOML from observation names and settings of common training libraries."""

from collections.abc import Sequence
from typing import Any

from deploy.plugins import TASKS, installed
from deploy.tasks.task import find_task

SOURCES: dict[str, str] = {
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
"""Names with the same meaning in all libraries. Joint positions are relative to a default pose in each of them."""


def without_none(**fields: Any) -> dict[str, Any]:
    """Return the fields that are known: not None."""
    return {name: value for name, value in fields.items() if value is not None}


def multiply_field(numbers: Sequence[float] | None) -> float | list[float] | None:
    """Return one number for all or one each; None if one is not positive, as after rounding to 0."""
    if numbers is None or min(numbers) <= 0:
        return None
    return numbers[0] if len(numbers) == 1 else list(numbers)


def gain_fields(kp: Sequence[float] | None, kd: Sequence[float] | None) -> dict[str, list[float]]:
    """Return both gains or none: exporters write 0 for drives that they cannot read."""
    if kp is None or kd is None or min(*kp, *kd) <= 0:
        return {}
    return {"kp": list(kp), "kd": list(kd)}


def term_fields(name: str, field_name: str, pose: list[float] | None, **fields: Any) -> dict[str, Any]:
    """Return the fields of one observation term.

    Args:
        name: of the term. field_name: its name in the training library.
        pose: (n,) rad, default pose that joint positions are relative to.
        fields: other known fields.
    """
    source = SOURCES.get(field_name)
    offset = None if source is None else pose if source == "joint_position" else "none"
    return without_none(name=name, source=source, offset=offset, **fields)


def contract_fields(observation: list[dict[str, Any]] | None, fill: str, **fields: Any) -> dict[str, Any]:
    """Return all known fields of the contract. These libraries group histories by term, oldest reading first.

    Args:
        observation: fields of the terms.
        fill: values before the first reading.
        fields: other known fields.
    """
    terms = observation or []
    has_history = any(term_fields.get("history", 1) > 1 for term_fields in terms)
    history = {"layout": "by_term", "frames": "oldest_first", "fill": fill} if has_history else {}
    named = {term_fields.get("source") for term_fields in terms}
    tasks = [name for name in installed(TASKS) if named & find_task(name, name).sources.keys()]
    task = tasks[0] if len(tasks) == 1 else None
    return without_none(task=task, observation=observation, **history, **fields)
