"""Contract in the robot's joint order from a draft in the policy's, with the permutations between the two."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Contract
from deploy.policy.observation_sources import ObservationSource
from deploy.tasks.task import sources_of
from policies.importers.contract_draft import ContractDraft, TermDraft
from policies.importers.reference_policy import ABSENT, ReferencePolicy
from robots.errors import ConfigError, ContractError
from robots.spec import RobotSpec
from robots.strict import parse

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class BuiltContract:
    """Contract and permutations.

    Attributes:
        contract: in the robot's order.
        columns: (N,) for each number of the policy's observation, its index in the contract's; ABSENT where it is 0.
        joints: (A,) for each of the robot's joints, its index in the policy's action.
    """

    contract: Contract
    columns: Indices
    joints: Indices


class _Joints(NamedTuple):
    """Joint names in three orders.

    Attributes:
        observed, driven: in the policy's observation and action. robot: in the robot's own order.
        sources: observation sources of robot and task.
    """

    observed: tuple[str, ...]
    driven: tuple[str, ...]
    robot: tuple[str, ...]
    sources: Mapping[str, ObservationSource]

    def names_for(self, source: str) -> tuple[str, ...]:
        """Return the joints of a source in the policy's order."""
        return self.driven if source == "last_action" else self.observed

    @property
    def action(self) -> Indices:
        """(A,) for each of the robot's joints, its index in the policy's action."""
        return _positions_of(self.driven, self.robot)


def build_contract(
    draft: ContractDraft, reference: ReferencePolicy, spec: RobotSpec, source: str
) -> BuiltContract:
    """Build the contract in the robot's joint order; `source` names the draft in error messages.

    Raises:
        ContractError: the draft does not fit the policy's file, or names other joints than the robot's.
    """
    sources, driven = _sources(draft, source), draft.action_joints or draft.joint_names
    joints = _Joints(draft.joint_names, driven, spec.joint_names, sources)
    _check_joints(joints, draft, spec, source)
    sizes = [
        joints.sources[term.source].size or len(joints.names_for(term.source)) for term in draft.observation
    ]
    _check_sizes(draft, joints, sizes, reference, source)
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
        "memory": reference.memory_size,
        "trained": {"imported": reference.facts.kind},
        "observed": _observed(reference, columns),
    }
    contract = parse(data, Contract, source=source, error=ContractError)
    return BuiltContract(contract=contract, columns=columns, joints=joints.action)


def _sources(draft: ContractDraft, source: str) -> Mapping[str, ObservationSource]:
    """Return the observation sources that a draft may name.

    Raises:
        ContractError: its task is not installed, or it names another source.
    """
    try:
        sources = sources_of(draft.task)
    except ConfigError as e:
        raise ContractError(f"{source}: {e}") from e
    for term in draft.observation:
        if term.source not in sources:
            raise ContractError(
                f"{source}: observation {term.name!r}: source: found {term.source!r}, expected one of"
                f" {', '.join(sources)}"
            )
    return sources


def _check_joints(joints: _Joints, draft: ContractDraft, spec: RobotSpec, source: str) -> None:
    field = "joint_names" if draft.action_joints is None else "action_joints"
    for name in (*joints.driven, *joints.robot):
        if name not in joints.robot:
            near = ", ".join(get_close_matches(name, joints.robot)) or ", ".join(joints.robot)
            raise ContractError(
                f"{source}: {field}: {spec.name} has no joint {name!r}, expected one of {near}"
            )
        _check_once(joints.driven, name, f"{source}: {field}")
    for name in (*joints.observed, *joints.robot):
        _check_once(joints.observed, name, f"{source}: joint_names")
    if others := [name for name in joints.observed if name not in joints.robot]:
        for term in draft.observation:
            where = f"{source}: observation {term.name!r}"
            _check_constant(term, joints, where, f"{others[0]!r}, not a joint of {spec.name}")


def _check_once(names: tuple[str, ...], name: str, source: str) -> None:
    if names.count(name) != 1:
        raise ContractError(f"{source}: found {name!r} {names.count(name)} times, expected once")


def _check_constant(term: TermDraft, joints: _Joints, source: str, joint: str) -> None:
    """Refuse a term that is not 0 for a joint resting at its default position."""
    if joints.sources[term.source].frame != "joint" or term.source == "last_action":
        return
    low, high = term.clip or (0.0, 0.0)
    at_rest = {"joint_position": bool(term.offset), "joint_velocity": not any(term.offset)}
    if not at_rest.get(term.source) or not low <= 0 <= high:
        raise ContractError(
            f"{source}: {term.source}: cannot be known of {joint}: expected a position with the default pose as"
            " offset, or a velocity without offset, and 0 inside clip"
        )


def _check_sizes(
    draft: ContractDraft, joints: _Joints, sizes: list[int], reference: ReferencePolicy, source: str
) -> None:
    facts = reference.facts
    total = sum(term.history * size for term, size in zip(draft.observation, sizes, strict=True))
    if total != facts.observations:
        parts = " + ".join(
            f"{term.name} {size}" + (f" x {term.history}" if term.history > 1 else "")
            for term, size in zip(draft.observation, sizes, strict=True)
        )
        raise ContractError(
            f"{source}: observation: found {total} numbers ({parts}), the policy takes {facts.observations}"
        )
    if facts.actions != (count := len(joints.driven)):
        field = "joint_names" if draft.action_joints is None else "action_joints"
        raise ContractError(f"{source}: {field}: found {count}, the policy gives {facts.actions} actions")


def _columns(draft: ContractDraft, joints: _Joints) -> Indices:
    """Return `BuiltContract.columns`; contracts are ordered by term, oldest reading first, robot's joint order."""
    blocks, start = [], 0  # per term: (history, size) columns of the contract in the policy's joint order
    for term in draft.observation:
        size = joints.sources[term.source].size or len(joints.robot)
        block = start + np.arange(term.history * size).reshape(term.history, size)
        start += block.size
        if joints.sources[term.source].frame == "joint":
            padded = np.pad(block, ((0, 0), (0, 1)), constant_values=ABSENT)
            size_in_file = joints.names_for(term.source)
            block = padded[:, [joints.robot.index(n) if n in joints.robot else size for n in size_in_file]]
        blocks.append(block[::-1] if draft.frames == "newest_first" else block)
    if draft.layout == "by_time":
        return np.concatenate(blocks, axis=1).ravel()
    return np.concatenate([block.ravel() for block in blocks])


def _term(term: TermDraft, joints: _Joints, draft: ContractDraft, source: str) -> dict[str, object]:
    size = joints.sources[term.source].size or len(joints.robot)
    size_in_file, order = size, np.arange(size)
    if joints.sources[term.source].frame == "joint":
        names = joints.names_for(term.source)
        size_in_file, order = len(names), _positions_of(names, joints.robot)
    where = f"{source}: observation {term.name!r}"
    multiply = _expand(term.multiply, size_in_file, order, f"{where}: multiply")
    clip = term.clip
    if clip is not None and term.clip_first:
        clip = (clip[0] * term.multiply[0], clip[1] * term.multiply[0])
    declared = joints.sources[term.source]
    return {
        "name": term.name,
        "source": term.source,
        "frame": declared.frame,
        "unit": declared.unit,
        "size": size,
        "offset": _expand(term.offset, size_in_file, order, f"{where}: offset") if term.offset else None,
        "scale": tuple(1.0 / factor for factor in multiply),
        "clip": clip,
        "history": term.history,
        "fill": draft.fill or "first",
        "period_s": term.period_s,
    }


def _action(draft: ContractDraft, joints: _Joints, source: str) -> dict[str, object]:
    action, where, size, order = draft.action, f"{source}: action", len(joints.driven), joints.action
    given = {name: getattr(action, name) for name in ("offset", "kp", "kd")}
    return {
        "mode": action.mode,
        "size": size,
        "scale": _expand(action.multiply, size, order, f"{where}: multiply"),
        "clip": action.clip,
        "leash_rad": action.leash_rad,
        **{name: _expand(n, size, order, f"{where}: {name}") if n else None for name, n in given.items()},
    }


def _positions_of(names: tuple[str, ...], robot: tuple[str, ...]) -> Indices:
    """Return for each of the robot's joints its index in `names`."""
    return np.array([names.index(name) for name in robot])


def _expand(numbers: tuple[float, ...], size: int, order: Indices, source: str) -> tuple[float, ...]:
    """Return one number per element in the robot's order, from one for all or `size` in the policy's order."""
    if len(numbers) not in (1, size):
        raise ContractError(f"{source}: found {len(numbers)} numbers, expected 1 or {size}")
    return tuple(float(numbers[k if len(numbers) > 1 else 0]) for k in order)


def _observed(reference: ReferencePolicy, columns: Indices) -> dict[str, object] | None:
    if reference.mean is None or reference.deviation is None:
        return None
    robot = np.argsort(columns)[np.count_nonzero(columns == ABSENT) :]
    return {
        "mean": tuple(reference.mean[k] for k in robot),
        "deviation": tuple(reference.deviation[k] for k in robot),
    }
