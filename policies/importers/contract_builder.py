"""From a draft in the policy's order to a contract in the robot's, and the way between the two."""

from dataclasses import dataclass
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Contract
from deploy.policy.observation_terms import READINGS, Source
from policies.importers.contract_draft import Draft, TermDraft
from policies.importers.reference_policy import STILL, Original
from robots.errors import ContractError
from robots.spec import RobotSpec
from robots.strict import parse

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Settled:
    """A contract and two orders.

    Attributes:
        contract: in the robot's order.
        columns: (N,) which of our observation's numbers stands where in the policy's; STILL: none, but 0.
        joints: (A,) which of the policy's joints stands where in ours.
    """

    contract: Contract
    columns: Indices
    joints: Indices


class _Joints(NamedTuple):
    """Names of joints, in three orders.

    Attributes:
        observed, moved: by the policy. ours: by the robot.
    """

    observed: tuple[str, ...]
    moved: tuple[str, ...]
    ours: tuple[str, ...]

    def of(self, source: Source) -> tuple[str, ...]:
        """Those of a reading, as the policy has them."""
        return self.moved if source == "last_action" else self.observed

    @property
    def action(self) -> Indices:
        """Which of the policy's joints stands where in ours."""
        return _places(self.moved, self.ours)


def settle(draft: Draft, original: Original, spec: RobotSpec, source: str) -> Settled:
    """Put a draft in the order of a robot; `source` names it in messages.

    Raises:
        ContractError: it does not fit the policy's file, or names other joints than the robot has.
    """
    joints = _Joints(draft.joint_names, draft.action_joints or draft.joint_names, spec.joint_names)
    _check_joints(joints, draft, spec, source)
    sizes = [READINGS[term.source].size or len(joints.of(term.source)) for term in draft.observation]
    _check_sizes(draft, joints, sizes, original, source)
    columns = _columns(draft, joints)
    data = {
        "robot": draft.robot,
        "robot_digest": spec.digest,
        "joint_names": spec.joint_names,
        "policy_hz": draft.policy_hz,
        "control_hz": spec.rates.control_hz,
        "task": draft.task,
        "observation": tuple(_term(term, joints, draft, source) for term in draft.observation),
        "action": _action(draft, joints, source),
        "memory": original.memory_size,
        "trained": {"imported": original.facts.kind},
        "observed": _observed(original, columns),
    }
    contract = parse(data, Contract, source=source, error=ContractError)
    return Settled(contract=contract, columns=columns, joints=joints.action)


def _check_joints(joints: _Joints, draft: Draft, spec: RobotSpec, source: str) -> None:
    field = "joint_names" if draft.action_joints is None else "action_joints"
    for name in (*joints.moved, *joints.ours):
        if name not in joints.ours:
            near = ", ".join(get_close_matches(name, joints.ours)) or ", ".join(joints.ours)
            raise ContractError(
                f"{source}: {field}: {spec.name} has no joint {name!r}, expected one of {near}"
            )
        _check_once(joints.moved, name, f"{source}: {field}")
    for name in (*joints.observed, *joints.ours):
        _check_once(joints.observed, name, f"{source}: joint_names")
    if others := [name for name in joints.observed if name not in joints.ours]:
        for term in draft.observation:
            _check_still(
                term, f"{source}: observation {term.name!r}", f"{others[0]!r}, which {spec.name} has not"
            )


def _check_once(names: tuple[str, ...], name: str, source: str) -> None:
    if names.count(name) != 1:
        raise ContractError(f"{source}: found {name!r} {names.count(name)} times, expected it once")


def _check_still(term: TermDraft, source: str, joint: str) -> None:
    """Whether 0 stands for a joint that never leaves its default position."""
    if READINGS[term.source].frame != "joint" or term.source == "last_action":
        return
    low, high = term.clip or (0.0, 0.0)
    at_rest = {"joint_position": bool(term.offset), "joint_velocity": not any(term.offset)}
    if not at_rest.get(term.source) or not low <= 0 <= high:
        raise ContractError(
            f"{source}: {term.source}: cannot be known of {joint}: expected a position with its default pose for an"
            " offset, or a velocity without one, and 0 inside clip"
        )


def _check_sizes(draft: Draft, joints: _Joints, sizes: list[int], original: Original, source: str) -> None:
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
    if facts.actions != (count := len(joints.moved)):
        field = "joint_names" if draft.action_joints is None else "action_joints"
        raise ContractError(f"{source}: {field}: found {count}, the policy gives {facts.actions} actions")


def _columns(draft: Draft, joints: _Joints) -> Indices:
    """Ours stands by term, oldest first, joints as the robot has them."""
    places, start = [], 0  # of each term: (history, size), our columns in the policy's order of joints
    for term in draft.observation:
        size = READINGS[term.source].size or len(joints.ours)
        block = start + np.arange(term.history * size).reshape(term.history, size)
        start += block.size
        if READINGS[term.source].frame == "joint":
            with_still = np.pad(block, ((0, 0), (0, 1)), constant_values=STILL)
            theirs = joints.of(term.source)
            block = with_still[:, [joints.ours.index(n) if n in joints.ours else size for n in theirs]]
        places.append(block[::-1] if draft.frames == "newest_first" else block)
    if draft.layout == "by_time":
        return np.concatenate(places, axis=1).ravel()
    return np.concatenate([block.ravel() for block in places])


def _term(term: TermDraft, joints: _Joints, draft: Draft, source: str) -> dict[str, object]:
    size = READINGS[term.source].size or len(joints.ours)
    theirs, order = size, np.arange(size)
    if READINGS[term.source].frame == "joint":
        names = joints.of(term.source)
        theirs, order = len(names), _places(names, joints.ours)
    where = f"{source}: observation {term.name!r}"
    multiply = _each(term.multiply, theirs, order, f"{where}: multiply")
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
        "offset": _each(term.offset, theirs, order, f"{where}: offset") if term.offset else None,
        "scale": tuple(1.0 / factor for factor in multiply),
        "clip": clip,
        "history": term.history,
        "fill": draft.fill or "first",
        "period_s": term.period_s,
    }


def _action(draft: Draft, joints: _Joints, source: str) -> dict[str, object]:
    action, where, size, order = draft.action, f"{source}: action", len(joints.moved), joints.action
    given = {name: getattr(action, name) for name in ("offset", "kp", "kd")}
    return {
        "mode": action.mode,
        "size": size,
        "scale": _each(action.multiply, size, order, f"{where}: multiply"),
        "clip": action.clip,
        "leash_rad": action.leash_rad,
        **{name: _each(n, size, order, f"{where}: {name}") if n else None for name, n in given.items()},
    }


def _places(names: tuple[str, ...], ours: tuple[str, ...]) -> Indices:
    """Where in `names` each of ours stands."""
    return np.array([names.index(name) for name in ours])


def _each(numbers: tuple[float, ...], size: int, order: Indices, source: str) -> tuple[float, ...]:
    """One for each, in our order, from one for all or `size` in theirs."""
    if len(numbers) not in (1, size):
        raise ContractError(f"{source}: found {len(numbers)} numbers, expected 1 or {size}")
    return tuple(float(numbers[k if len(numbers) > 1 else 0]) for k in order)


def _observed(original: Original, columns: Indices) -> dict[str, object] | None:
    if original.mean is None or original.deviation is None:
        return None
    ours = np.argsort(columns)[np.count_nonzero(columns == STILL) :]
    return {
        "mean": tuple(original.mean[k] for k in ours),
        "deviation": tuple(original.deviation[k] for k in ours),
    }
