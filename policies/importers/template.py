"""The first draft of a contract: all that the policy's file says, and a question mark for all that it does not."""

from collections.abc import Mapping
from typing import Any, TypeVar, get_args

import tomlkit
from tomlkit.items import Table

from deploy.policy.observation_terms import READINGS
from policies.importers.reference_policy import Facts
from policies.importers.torch_files.network_settings import Activation
from robots.strict import OPEN, open_fields

Part = TypeVar("Part", tomlkit.TOMLDocument, Table)

HEAD = """What the numbers of {name} mean: {kind}, {observations} observations, {actions} actions.
Every "{open}" is to be filled in, from the code that trained it. "none" stands for nothing, said on purpose.
Sources of an observation, each with its frame and unit:
{sources}"""
FIELDS = {
    "robot": "name of the robot",
    "task": '"reach" or "velocity"',
    "policy_hz": "Hz, how often it is asked",
    "joint_names": "the robot's joints in the policy's own order",
}
MOVED = {"action_joints": "those of joint_names that it moves, in the order of its action"}
HISTORY = {
    "layout": '"by_term" or "by_time": whether readings of each term stand together, or those of each time',
    "frames": '"oldest_first" or "newest_first"',
    "fill": '"first" or "zeros": what stands there before the first reading',
}
TERM = {
    "name": "a name of its own; one such table for each term, in the policy's order",
    "source": "what is measured: one of the sources above",
    "offset": "taken away from the reading; one number, one for each, or none",
    "multiply": "then multiplied; one number, or one for each",
    "clip": "[low, high] or none",
    "clip_first": "true: clipped before multiplied",
    "history": "readings kept, 1 for none but the newest; gait_phase has period_s too, s of one gait",
}
ACTION = {
    "mode": '"position" (target = offset + multiply * action) or "position_increment"',
    "offset": "rad, the pose of an action of 0; none for increments",
    "multiply": "rad per unit of action",
    "clip": "[low, high] of the raw action, or none",
    "kp": "N·m/rad, gains of the drives in training; none: the robot's own",
    "kd": "N·m·s/rad",
}

NETWORK = {
    "activation": f"between layers: {', '.join(get_args(Activation))}",
    "normalizer": 'of observations: "none", { mean = [...], std = [...] } of weights, or the file of a VecNormalize',
}


def written(facts: Facts, name: str) -> tuple[str, int]:
    """The text of the TOML, and how many of its values are still open."""
    known = facts.known
    document = tomlkit.document()
    sources = "\n".join(f"  {name}: {frame}, {unit}" for name, (frame, unit, *_) in READINGS.items())
    head = HEAD.format(
        name=name,
        kind=facts.kind,
        observations=facts.observations,
        actions=facts.actions,
        open=OPEN,
        sources=sources,
    )
    for line in head.splitlines():
        document.add(tomlkit.comment(line))
    terms = known.get("observation") or [{}]
    moved = MOVED if "action_joints" in known else {}
    asked = FIELDS | moved | (HISTORY if any(term.get("history", 1) != 1 for term in terms) else {})
    _fill(document, {key: known[key] for key in asked if key in known}, asked)
    observation = tomlkit.aot()
    for term in terms:
        observation.append(_fill(tomlkit.table(), term, TERM))
    document.add("observation", observation)
    document.add("action", _fill(tomlkit.table(), known.get("action") or {}, ACTION))
    if network := known.get("network"):
        about = {key: meaning for key, meaning in NETWORK.items() if key in network}
        document.add("network", _fill(tomlkit.table(), network, about))
    text = tomlkit.dumps(document)
    return text, len(list(open_fields(document.unwrap())))


def _fill(table: Part, known: Mapping[str, Any], asked: Mapping[str, str]) -> Part:
    """What is asked and what else is known, each with its meaning behind it."""
    for key in [*asked, *(key for key in known if key not in asked)]:
        item = tomlkit.item(known.get(key, OPEN))
        if key in asked:
            item.comment(asked[key])
        table.add(key, item)
    return table
