"""Contract in the robot's joint order from a draft in the policy's, with the permutations between the two."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Contract
from deploy.sources.source import ObservationSource
from deploy.tasks.task import sources_of
from policies.importers.contract_draft import ContractDraft, TermDraft
from policies.importers.reference_policy import ABSENT, PolicyFacts, ReferencePolicy
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


class _Block(NamedTuple):
    """One term of a draft with its joints.

    Attributes:
        source: declaration of its observation source.
        names: joints in the policy's order; () for a source that is not per joint.
        size: numbers in one reading of the contract.
    """

    term: TermDraft
    source: ObservationSource
    names: tuple[str, ...]
    size: int

    @property
    def size_in_file(self) -> int:
        """Numbers in one reading of the policy's observation."""
        return len(self.names) * self.source.size or self.size


def build_contract(
    draft: ContractDraft, reference: ReferencePolicy, spec: RobotSpec, source: str
) -> BuiltContract:
    """Build the contract in the robot's joint order; `source` names the draft in error messages."""
    builder = _Builder(draft, spec, source)
    builder.check_joints()
    builder.check_sizes(reference.facts)
    columns = builder.columns()
    data = builder.contract() | {
        "memory": reference.memory_size,
        "trained": {"imported": reference.facts.kind},
        "observed": _observed(reference, columns),
    }
    contract = parse(data, Contract, source=source, error=ContractError)
    return BuiltContract(contract=contract, columns=columns, joints=builder.joints)


class _Builder:
    """A draft with the robot's joint order.

    Attributes:
        driven: joints in the order of the action. driven_field: field of the draft that names them.
        joints: (A,) as in `BuiltContract`.
    """

    def __init__(self, draft: ContractDraft, spec: RobotSpec, path: str) -> None:
        self._draft, self._spec, self._path, self._robot = draft, spec, path, spec.joint_names
        self.driven_field = "joint_names" if draft.action_joints is None else "action_joints"
        self.driven = draft.action_joints or draft.joint_names
        try:
            sources = sources_of(draft.task)
        except ConfigError as e:
            raise ContractError(f"{path}: {e}") from e
        self.blocks = [self._block(term, sources) for term in draft.observation]

    def _block(self, term: TermDraft, sources: Mapping[str, ObservationSource]) -> _Block:
        if term.source not in sources:
            found, known = f"source: found {term.source!r}", ", ".join(sources)
            raise self._error(f"observation {term.name!r}", f"{found}, expected one of {known}")
        source = sources[term.source]
        names = self.driven if term.source == "last_action" else self._draft.joint_names
        legs = len(term.phase_offsets) if term.source == "gait_phase" else 1
        return _Block(term, source, names if source.each == "joint" else (), legs * source.count(self._spec))

    def _error(self, field: str, text: str) -> ContractError:
        return ContractError(f"{self._path}: {field}: {text}")

    @property
    def joints(self) -> Indices:
        """(A,) for each of the robot's joints, its index in the policy's action."""
        return _positions_of(self.driven, self._robot)

    def check_joints(self) -> None:
        """Refuse unknown, missing and repeated joints, and terms that depend on joints of no robot."""
        for name in (*self.driven, *self._robot):
            if name not in self._robot:
                near = ", ".join(get_close_matches(name, self._robot) or self._robot)
                found = f"{self._spec.name} has no joint {name!r}"
                raise self._error(self.driven_field, f"{found}, expected one of {near}")
            self._check_once(self.driven, name, self.driven_field)
        for name in (*self._draft.joint_names, *self._robot):
            self._check_once(self._draft.joint_names, name, "joint_names")
        if others := [name for name in self._draft.joint_names if name not in self._robot]:
            for block in self.blocks:
                self._check_constant(block, others[0])

    def _check_once(self, names: tuple[str, ...], name: str, field: str) -> None:
        if names.count(name) != 1:
            raise self._error(field, f"found {name!r} {names.count(name)} times, expected once")

    def _check_constant(self, block: _Block, joint: str) -> None:
        """Refuse a term that is not 0 for a joint resting at its default position."""
        term = block.term
        if not block.names or term.source == "last_action":
            return
        low, high = term.clip or (0.0, 0.0)
        at_rest = {"joint_position": bool(term.offset), "joint_velocity": not any(term.offset)}
        if not at_rest.get(term.source) or not low <= 0 <= high:
            raise self._error(
                f"observation {term.name!r}: {term.source}",
                f"cannot be known of {joint!r}, not a joint of {self._spec.name}: expected a position with the"
                " default pose as offset, or a velocity without offset, and 0 inside clip",
            )

    def check_sizes(self, facts: PolicyFacts) -> None:
        """Compare the sizes of observation and action with those of the policy's file."""
        total = sum(block.term.history * block.size_in_file for block in self.blocks)
        if total != facts.observations:
            parts = " + ".join(
                f"{term.name} {block.size_in_file}" + (f" x {term.history}" if term.history > 1 else "")
                for block in self.blocks
                for term in (block.term,)
            )
            found = f"found {total} numbers ({parts})"
            raise self._error("observation", f"{found}, the policy takes {facts.observations}")
        if facts.actions != (count := len(self.driven)):
            raise self._error(self.driven_field, f"found {count}, the policy gives {facts.actions} actions")

    def columns(self) -> Indices:
        """Return `BuiltContract.columns`; contracts are ordered by term, oldest reading first."""
        parts, start = [], 0  # per term: (history, size) columns of the contract in the policy's joint order
        for block in self.blocks:
            history, size = block.term.history, block.size
            part = start + np.arange(history * size).reshape(history, size)
            start += part.size
            if block.names:
                joints, each = len(self._robot), block.source.size
                padded = np.pad(part, ((0, 0), (0, each)), constant_values=ABSENT).reshape(history, -1, each)
                places = [self._robot.index(n) if n in self._robot else joints for n in block.names]
                part = padded[:, places].reshape(history, -1)
            parts.append(part[::-1] if self._draft.frames == "newest_first" else part)
        if self._draft.layout == "by_time":
            return np.concatenate(parts, axis=1).ravel()
        return np.concatenate([part.ravel() for part in parts])

    def contract(self) -> dict[str, object]:
        """Return the fields of the contract that follow from draft and robot."""
        return {
            **self._draft.model_dump(include={"robot", "task", "policy_hz"}),
            "robot_digest": self._spec.digest,
            "joint_names": self._robot,
            "control_hz": self._spec.rates.control_hz,
            "observation": tuple(self._term(block) for block in self.blocks),
            "action": self._action(),
        }

    def _term(self, block: _Block) -> dict[str, object]:
        term, size = block.term, block.size_in_file
        order = np.arange(size)
        if block.names:
            order = order.reshape(-1, block.source.size)[_positions_of(block.names, self._robot)].ravel()
        where = f"{self._path}: observation {term.name!r}"
        multiply = _expand(term.multiply, size, order, f"{where}: multiply")
        factor = term.multiply[0] if term.clip_first else 1.0
        return {
            **term.model_dump(include={"name", "source", "history", "period_s", "phase_offsets", "layout"}),
            "frame": block.source.frame,
            "unit": block.source.unit,
            "size": block.size,
            "offset": _expand(term.offset, size, order, f"{where}: offset") if term.offset else None,
            "scale": tuple(1.0 / number for number in multiply),
            "clip": tuple(bound * factor for bound in term.clip) if term.clip else None,
            "fill": self._draft.fill or "first",
        }

    def _action(self) -> dict[str, object]:
        action, size, where = self._draft.action, len(self.driven), f"{self._path}: action"
        return {
            **action.model_dump(include={"mode", "clip", "leash_rad"}),
            "size": size,
            "scale": _expand(action.multiply, size, self.joints, f"{where}: multiply"),
            **{
                name: _expand(numbers, size, self.joints, f"{where}: {name}") if numbers else None
                for name, numbers in (("offset", action.offset), ("kp", action.kp), ("kd", action.kd))
            },
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
    both = {"mean": reference.mean, "deviation": reference.deviation}
    return {name: tuple(numbers[k] for k in robot) for name, numbers in both.items()}
