"""Reader of Isaac Lab's I/O descriptors: the YAML with the observation and action terms of a task.

Source: isaac-sim/IsaacLab 2.2 and 3.0, scripts/environments/export_io_descriptors.py and source/isaaclab/isaaclab:
envs/utils/io_descriptors.py, managers/observation_manager.py, managers/action_manager.py, envs/mdp/observations.py,
envs/mdp/actions/joint_actions.py.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from deploy.policy.contract_term import SIZE_MAX, Clip, Count, Name, Number, Numbers, Positive
from policies.importers.draft_fields import (
    FAR,
    SOURCES,
    Part,
    as_tuple,
    contract_fields,
    gain_fields,
    multiply_field,
    without_none,
)
from policies.importers.untrusted.yaml_file import read_yaml
from robots.errors import ContractError
from robots.strict import parse

POSITION = ".JointPositionAction"


def _first_row(value: object) -> object:
    """Return the first row: some versions repeat it for each robot of the training."""
    return value[0] if isinstance(value, tuple) and value and isinstance(value[0], tuple) else value


def _bounded(value: object) -> object:
    """Replace infinite bounds by large numbers."""
    if isinstance(value, tuple):
        return tuple(_bounded(number) for number in value)
    return max(-FAR, min(value, FAR)) if isinstance(value, float) else value


Names = Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)]
OneOrEach = Annotated[Number | Numbers, BeforeValidator(_first_row)]
"""One number for all, or one per element."""
Bounds = Annotated[tuple[Clip, ...], BeforeValidator(_bounded), Field(max_length=SIZE_MAX)]


class _Overloads(Part):
    clip: Annotated[Clip | None, BeforeValidator(_bounded)]
    scale: Number | Numbers | None
    history_length: Annotated[int, Field(ge=0, le=SIZE_MAX)] | None
    flatten_history_dim: bool

    @property
    def history(self) -> int:
        """Number of readings, 1 for the newest only."""
        return max(1, self.history_length or 0)


class _Extras(Part):
    modifiers: None = None


class _Term(Part):
    name: Name
    shape: Annotated[tuple[Count, ...], Field(min_length=1, max_length=1)]
    overloads: _Overloads
    extras: _Extras
    joint_names: Names | None = None
    joint_pos_offsets: Numbers | None = None
    joint_vel_offsets: Numbers | None = None


class _Action(Part):
    full_path: Annotated[str, Field(max_length=1000)]
    joint_names: Names
    scale: OneOrEach
    offset: OneOrEach
    clip: Bounds | None


class _Articulation(Part):
    joint_names: Names
    default_joint_stiffness: Numbers
    default_joint_damping: Numbers


class _Observations(Part):
    policy: Annotated[tuple[_Term, ...], Field(min_length=1, max_length=SIZE_MAX)]


class _Scene(Part):
    dt: Annotated[Positive, Field(ge=1e-5, le=100)]

    @property
    def policy_hz(self) -> int | None:
        """Rate of the policy; None if it is no whole number."""
        hertz = 1 / self.dt
        return round(hertz) if abs(hertz - round(hertz)) < 1e-3 else None


class _Descriptor(Part):
    actions: Annotated[tuple[_Action, ...], Field(min_length=1, max_length=1)]
    articulations: Annotated[dict[Name, _Articulation], Field(max_length=100)]
    observations: _Observations
    scene: _Scene


def read_descriptor(path: Path, observations: int) -> dict[str, Any]:
    """Return the contract's fields that a descriptor gives; it must be of a policy with N = `observations`."""
    descriptor = parse(read_yaml(path), _Descriptor, source=str(path), error=ContractError)
    terms, (action,) = descriptor.observations.policy, descriptor.actions
    where = f"{path}: observations.policy"
    if (total := sum(term.shape[0] * term.overloads.history for term in terms)) != observations:
        raise ContractError(f"{where}: found {total} numbers, the policy takes {observations}")
    joints = _observed_joints(terms, action, where)
    return contract_fields(
        _terms(terms, where),
        "first",
        joint_names=list(joints),
        action_joints=None if joints == action.joint_names else list(action.joint_names),
        policy_hz=descriptor.scene.policy_hz,
        action=_action(action, descriptor.articulations, str(path)),
    )


def _observed_joints(terms: Sequence[_Term], action: _Action, where: str) -> tuple[str, ...]:
    joints, *others = dict.fromkeys(t.joint_names for t in terms if t.joint_names) or [action.joint_names]
    if others or not set(action.joint_names) <= set(joints):
        found, moved = list(others[0] if others else joints), list(action.joint_names)
        raise ContractError(
            f"{where}: joint_names: found {found!s:.300}, expected the same joints for each term, including those"
            f" of the action: {moved!s:.300}"
        )
    return joints


def _terms(terms: Sequence[_Term], where: str) -> list[dict[str, Any]]:
    counts: Counter[str] = Counter()
    fields = []
    for term in terms:
        counts[term.name] += 1
        if term.overloads.history_length and not term.overloads.flatten_history_dim:
            raise ContractError(f"{where}: {term.name}: flatten_history_dim: found false, expected true")
        count = counts[term.name]
        fields.append(_term(term, term.name if count == 1 else f"{term.name}_{count}"))
    return fields


def _term(term: _Term, name: str) -> dict[str, Any]:
    overloads, source = term.overloads, SOURCES.get(term.name)
    offset = {"joint_pos_rel": term.joint_pos_offsets, "joint_vel_rel": term.joint_vel_offsets}.get(term.name)
    none = None if term.name == "joint_pos_rel" else "none"
    return without_none(
        name=name,
        source=source,
        offset=None if source is None else list(offset) if offset and any(offset) else none,
        multiply=1.0 if overloads.scale is None else multiply_field(overloads.scale),
        clip=list(overloads.clip) if overloads.clip else "none",
        clip_first=True,
        history=overloads.history,
    )


def _check_action(action: _Action, source: str) -> None:
    count, scale = len(action.joint_names), as_tuple(action.scale)
    for field, found in (("scale", scale), ("offset", as_tuple(action.offset)), ("clip", action.clip or ())):
        expected = (0, count) if field == "clip" else (1, count)
        if len(found) not in expected:
            raise ContractError(f"{source}: actions.0.{field}: found {len(found)}, expected {count}")
    if action.clip and 0.0 in scale:
        reason = "since targets are clipped"
        raise ContractError(f"{source}: actions.0.scale: found 0, expected another number, {reason}")


def _action(action: _Action, articulations: Mapping[str, _Articulation], source: str) -> dict[str, Any]:
    """Return the action's fields; none unless joint positions are commanded."""
    _check_action(action, source)
    if not action.full_path.endswith(POSITION):
        return {}
    offset, scale = as_tuple(action.offset), as_tuple(action.scale)
    return without_none(
        mode="position",
        offset=list(offset) if any(offset) else "none",
        multiply=multiply_field(scale),
        clip=_raw_clip(action, offset, scale) if action.clip else "none",
        **_gains(action.joint_names, articulations),
    )


def _raw_clip(action: _Action, offset: Sequence[float], scale: Sequence[float]) -> list[float] | None:
    """Return the raw action's clip from Isaac Lab's clip of targets; None if it differs between joints.

    A negative scale swaps the lower and the upper bound.
    """
    raw = {
        tuple(sorted(max(-FAR, min(round((bound - o) / s, 6), FAR)) for bound in clip))
        for clip, o, s in zip(action.clip or (), cycle(offset), cycle(scale), strict=False)
    }
    return list(raw.pop()) if len(raw) == 1 else None


def _gains(names: Sequence[str], articulations: Mapping[str, _Articulation]) -> dict[str, list[float]]:
    """Return the gains from the articulation with these joints."""
    for arm in articulations.values():
        both = (arm.default_joint_stiffness, arm.default_joint_damping)
        if set(names) <= set(arm.joint_names) and all(len(n) == len(arm.joint_names) for n in both):
            places = [arm.joint_names.index(name) for name in names]
            return gain_fields(*([numbers[k] for k in places] for numbers in both))
    return {}
