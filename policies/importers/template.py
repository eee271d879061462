"""Template of a contract's TOML: values known from the policy's file, and "?" for the others."""

from collections.abc import Mapping
from typing import Any, TypeVar, get_args

import tomlkit
from tomlkit.items import Table

from deploy.plugins import TASKS, installed
from deploy.tasks.task import installed_sources
from policies.importers.reference_policy import PolicyFacts
from policies.importers.torch_files.network_settings import Activation
from robots.strict import PLACEHOLDER, placeholder_fields

Part = TypeVar("Part", tomlkit.TOMLDocument, Table)

HEAD = """Contract of {name}: {kind}, {observations} observations, {actions} actions.
Replace every "{open}", using the training code. "none" means that there is no such value.
Observation sources, each with frame and unit:
{sources}"""
FIELDS = {
    "robot": "name of the robot",
    "task": f"one of {', '.join(installed(TASKS))}",
    "policy_hz": "Hz, rate of the policy",
    "joint_names": "the robot's joints in the policy's order",
}
ACTION_JOINTS = {"action_joints": "those of joint_names that the action moves, in the order of the action"}
HISTORY = {
    "layout": '"by_term" or "by_time": readings grouped by term, or by time',
    "frames": '"oldest_first" or "newest_first"',
    "fill": '"first" (repeat the first reading) or "zeros": values before the first reading',
}
TERM = {
    "name": "unique name; one such table per term, in the policy's order",
    "source": "one of the sources above",
    "offset": "subtracted from the reading; one number, one per element, or none",
    "multiply": "then multiplied; one number, or one per element",
    "clip": "[low, high] or none",
    "clip_first": "true: clip before multiply; false: after",
    "history": "number of readings, 1 for the newest only; gait_phase also needs period_s, s, gait period",
}
ACTION = {
    "mode": '"position" (target = offset + multiply * action) or "position_increment"',
    "offset": "rad, joint positions at an action of 0; none for increments",
    "multiply": "rad per unit of action",
    "clip": "[low, high] of the raw action, or none",
    "kp": "N·m/rad, drive gains in training; none: the robot's own",
    "kd": "N·m·s/rad",
}

NETWORK = {
    "activation": f"activation between layers: {', '.join(get_args(Activation))}",
    "normalizer": 'of observations: "none", { mean = [...], std = [...] }, or the path of a VecNormalize file',
}


def render_template(facts: PolicyFacts, name: str) -> tuple[str, int]:
    """Return the text of the TOML, and the number of open values."""
    known = facts.known
    document = tomlkit.document()
    sources = "\n".join(f"  {name}: {s.frame}, {s.unit}" for name, s in installed_sources().items())
    head = HEAD.format(
        name=name,
        kind=facts.kind,
        observations=facts.observations,
        actions=facts.actions,
        open=PLACEHOLDER,
        sources=sources,
    )
    for line in head.splitlines():
        document.add(tomlkit.comment(line))
    terms = known.get("observation") or [{}]
    action_joints = ACTION_JOINTS if "action_joints" in known else {}
    descriptions = (
        FIELDS | action_joints | (HISTORY if any(term.get("history", 1) != 1 for term in terms) else {})
    )
    _fill(document, {key: known[key] for key in descriptions if key in known}, descriptions)
    observation = tomlkit.aot()
    for term in terms:
        observation.append(_fill(tomlkit.table(), term, TERM))
    document.add("observation", observation)
    document.add("action", _fill(tomlkit.table(), known.get("action") or {}, ACTION))
    if network := known.get("network"):
        settings = {key: meaning for key, meaning in NETWORK.items() if key in network}
        document.add("network", _fill(tomlkit.table(), network, settings))
    text = tomlkit.dumps(document)
    return text, len(list(placeholder_fields(document.unwrap())))


def _fill(table: Part, known: Mapping[str, Any], descriptions: Mapping[str, str]) -> Part:
    """Add the described keys and other known keys, each with its description as a comment."""
    for key in [*descriptions, *(key for key in known if key not in descriptions)]:
        item = tomlkit.item(known.get(key, PLACEHOLDER))
        if key in descriptions:
            item.comment(descriptions[key])
        table.add(key, item)
    return table
