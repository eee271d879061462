"""Fields of the contract's TOML from observation names and settings of common training libraries."""

from collections.abc import Sequence
from typing import Any

from deploy.plugins import TASKS, installed
from deploy.tasks.task import find_task
from robots.strict import Strict

FAR = 1e30
"""Stands for infinity where only one side of a clip is bounded."""

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


class Part(Strict, extra="ignore"):
    """Part of another library's record: other keys are ignored."""


def without_none(**fields: Any) -> dict[str, Any]:
    """Return the fields that are known: not None."""
    return {name: value for name, value in fields.items() if value is not None}


def as_tuple(numbers: float | Sequence[float]) -> tuple[float, ...]:
    """Return (number,) for one number."""
    return (numbers,) if isinstance(numbers, int | float) else tuple(numbers)


def multiply_field(numbers: float | Sequence[float] | None) -> float | list[float] | None:
    """Return one number for all or one each; None if one is not positive, as after rounding to 0."""
    if numbers is None or min(each := as_tuple(numbers)) <= 0:
        return None
    return each[0] if len(each) == 1 else list(each)


def gain_fields(kp: Sequence[float] | None, kd: Sequence[float] | None) -> dict[str, list[float]]:
    """Return both gains or none: exporters write 0 for drives that they cannot read."""
    if kp is None or kd is None or min(*kp, *kd) <= 0:
        return {}
    return {"kp": list(kp), "kd": list(kd)}


def term_fields(name: str, field_name: str, pose: list[float] | None, **fields: Any) -> dict[str, Any]:
    """Return the known fields of a term named `field_name` in its library; `pose` (n,) rad is what positions are of."""
    source = SOURCES.get(field_name)
    offset = None if source is None else pose if source == "joint_position" else "none"
    return without_none(name=name, source=source, offset=offset, **fields)


def contract_fields(observation: list[dict[str, Any]] | None, fill: str, **fields: Any) -> dict[str, Any]:
    """Return all known fields of the contract. These libraries group histories by term, oldest reading first."""
    terms = observation or []
    has_history = any(term.get("history", 1) > 1 for term in terms)
    history = {"layout": "by_term", "frames": "oldest_first", "fill": fill} if has_history else {}
    named = {term.get("source") for term in terms}
    tasks = [name for name in installed(TASKS) if named & find_task(name, name).sources.keys()]
    task = tasks[0] if len(tasks) == 1 else None
    return without_none(task=task, observation=observation, **history, **fields)
