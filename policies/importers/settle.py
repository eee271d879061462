"""From a draft in the policy's order to a contract in the robot's, and the way between the two."""

from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from deploy.contract import Contract
from deploy.terms import READINGS
from policies.importers.draft import Draft, TermDraft
from policies.importers.original import Original
from robots.errors import ContractError
from robots.spec import RobotSpec
from robots.strict import parse

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Settled:
    """A contract and two orders.

    Attributes:
        contract: in the robot's order.
        columns: (N,) which of our observation's numbers stands where in the policy's.
        joints: (A,) which of the policy's joints stands where in ours.
    """

    contract: Contract
    columns: Indices
    joints: Indices


def settle(draft: Draft, original: Original, spec: RobotSpec, source: str) -> Settled:
    """Put a draft in the order of a robot; `source` names it in messages.

    Raises:
        ContractError: it does not fit the policy's file, or names other joints than the robot has.
    """
    joints = _joints(draft.joint_names, spec, source)
    sizes = [READINGS[term.source].size or spec.n for term in draft.observation]
    _check_sizes(draft, sizes, original, source)
    columns = _columns(draft, sizes, np.argsort(joints))
    terms = [
        _term(term, size, joints, draft, source) for term, size in zip(draft.observation, sizes, strict=True)
    ]
    data = {
        "robot": draft.robot,
        "robot_digest": spec.digest,
        "joint_names": spec.joint_names,
        "policy_hz": draft.policy_hz,
        "control_hz": spec.rates.control_hz,
        "task": draft.task,
        "observation": tuple(terms),
        "action": _action(draft, joints, source),
        "memory": original.memory_size,
        "trained": {"imported": original.facts.kind},
        "observed": _observed(original, columns),
    }
    return Settled(
        contract=parse(data, Contract, source=source, error=ContractError), columns=columns, joints=joints
    )


def _joints(names: tuple[str, ...], spec: RobotSpec, source: str) -> Indices:
    for name in (*names, *spec.joint_names):
        if name not in spec.joint_names:
            near = ", ".join(get_close_matches(name, spec.joint_names)) or ", ".join(spec.joint_names)
            raise ContractError(
                f"{source}: joint_names: {spec.name} has no joint {name!r}, expected one of {near}"
            )
        if names.count(name) != 1:
            raise ContractError(
                f"{source}: joint_names: found {name!r} {names.count(name)} times, expected it once"
            )
    return np.array([names.index(name) for name in spec.joint_names])


def _check_sizes(draft: Draft, sizes: list[int], original: Original, source: str) -> None:
    facts = original.facts
    total = sum(term.history * size for term, size in zip(draft.observation, sizes, strict=True))
    if total != facts.observations:
        parts = " + ".join(
            f"{term.name} {size}" + (f" x {term.history}" if term.history > 1 else "")
            for term, size in zip(draft.observation, sizes, strict=True)
        )
        raise ContractError(
            f"{source}: observation: found {total} numbers ({parts}), the policy takes {facts.observations}"
        )
    if facts.actions != len(draft.joint_names):
        raise ContractError(
            f"{source}: joint_names: found {len(draft.joint_names)}, the policy gives {facts.actions} actions"
        )


def _columns(draft: Draft, sizes: list[int], robots_order: Indices) -> Indices:
    """Ours stands by term, oldest first, joints as the robot has them."""
    places, start = [], 0  # of each term: (history, size), our columns in the policy's order of joints
    for term, size in zip(draft.observation, sizes, strict=True):
        block = start + np.arange(term.history * size).reshape(term.history, size)
        start += block.size
        if READINGS[term.source].frame == "joint":
            block = block[:, robots_order]
        places.append(block[::-1] if draft.frames == "newest_first" else block)
    if draft.layout == "by_time":
        return np.concatenate(places, axis=1).ravel()
    return np.concatenate([block.ravel() for block in places])


def _term(term: TermDraft, size: int, joints: Indices, draft: Draft, source: str) -> dict[str, object]:
    order = joints if READINGS[term.source].frame == "joint" else np.arange(size)
    where = f"{source}: observation {term.name!r}"
    multiply = _each(term.multiply, order, f"{where}: multiply")
    clip = term.clip
    if clip is not None and term.clip_first:
        clip = (clip[0] * term.multiply[0], clip[1] * term.multiply[0])
    frame, unit = READINGS[term.source][:2]
    return {
        "name": term.name,
        "source": term.source,
        "frame": frame,
        "unit": unit,
        "size": size,
        "offset": _each(term.offset, order, f"{where}: offset") if term.offset else None,
        "scale": tuple(1.0 / factor for factor in multiply),
        "clip": clip,
        "history": term.history,
        "fill": draft.fill or "first",
        "period_s": term.period_s,
    }


def _action(draft: Draft, joints: Indices, source: str) -> dict[str, object]:
    action, where = draft.action, f"{source}: action"
    given = {name: getattr(action, name) for name in ("offset", "kp", "kd")}
    return {
        "mode": action.mode,
        "size": len(joints),
        "scale": _each(action.multiply, joints, f"{where}: multiply"),
        "clip": action.clip,
        "leash_rad": action.leash_rad,
        **{name: _each(n, joints, f"{where}: {name}") if n else None for name, n in given.items()},
    }


def _each(numbers: tuple[float, ...], order: Indices, source: str) -> tuple[float, ...]:
    """One for each, in our order."""
    if len(numbers) not in (1, len(order)):
        raise ContractError(f"{source}: found {len(numbers)} numbers, expected 1 or {len(order)}")
    return tuple(float(numbers[k if len(numbers) > 1 else 0]) for k in order)


def _observed(original: Original, columns: Indices) -> dict[str, object] | None:
    if original.mean is None or original.deviation is None:
        return None
    ours = np.argsort(columns)
    return {
        "mean": tuple(original.mean[k] for k in ours),
        "deviation": tuple(original.deviation[k] for k in ours),
    }
