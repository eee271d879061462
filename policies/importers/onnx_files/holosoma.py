"""Metadata of ONNX files of holosoma, with values in JSON.

Source: amazon-far/holosoma 0.0.3, src/holosoma/holosoma: agents/ppo/ppo.py, utils/inference_helpers.py,
managers/observation/manager.py, managers/action/terms/joint_control.py, envs/base_task/base_task.py, config_types/.
"""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AliasPath, Field

from deploy.policy.contract import TEXT_MAX, Hertz
from deploy.policy.contract_term import SIZE_MAX, Clip, Count, Name, Number, Numbers, Positive
from policies.importers.draft_fields import (
    Part,
    contract_fields,
    gain_fields,
    multiply_field,
    term_fields,
    without_none,
)
from robots.errors import ContractError
from robots.strict import parse, read_json

POSITION = "JointPositionActionTerm"
Path = Annotated[str, Field(max_length=1000)]
"""module:name of Python."""


class _Term(Part):
    name: Name
    func: Path
    history_length: Count
    scale: Number | Numbers
    clip: Clip | None


class _ActionTerm(Part):
    func: Path


class _Experiment(Part):
    fps: Hertz = Field(validation_alias=AliasPath("simulator", "config", "sim", "fps"))
    decimation: Count = Field(validation_alias=AliasPath("simulator", "config", "sim", "control_decimation"))
    control_type: Name = Field(validation_alias=AliasPath("robot", "control", "control_type"))
    clip_actions: bool = Field(validation_alias=AliasPath("robot", "control", "clip_actions"))
    clip_value: Positive = Field(validation_alias=AliasPath("robot", "control", "action_clip_value"))
    pose: dict[Name, Number] = Field(
        validation_alias=AliasPath("robot", "init_state", "default_joint_angles"), max_length=SIZE_MAX
    )
    actions: dict[Name, _ActionTerm] = Field(
        validation_alias=AliasPath("action", "terms"), max_length=SIZE_MAX
    )

    @property
    def hertz(self) -> int | None:
        """Rate of the policy, Hz; None if it is no whole number."""
        return None if self.fps % self.decimation else self.fps // self.decimation


class _Metadata(Part):
    dof_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=SIZE_MAX)]
    kp: Numbers | None = None
    kd: Numbers | None = None
    action_scale: Number | Numbers | None = None
    observation_layout: Annotated[tuple[_Term, ...], Field(max_length=SIZE_MAX)] | None = None
    observation_clip: Positive | None = None
    experiment_config: _Experiment | None = None


def known_from(metadata: Mapping[str, str], source: str) -> dict[str, Any]:
    """Return the contract's known fields, as `metadata.known_from`."""
    data = {
        key: read_json(metadata[key], f"{source}: metadata {key!r}", TEXT_MAX, ContractError)
        for key in _Metadata.model_fields
        if key in metadata
    }
    found = parse(data, _Metadata, source=f"{source}: metadata", error=ContractError)
    joints, experiment = list(found.dof_names), found.experiment_config
    _check_sizes(found, source)
    pose = _pose(experiment, joints, source) if experiment else None
    action = without_none(
        **(_action(experiment, pose) if experiment else {}),
        multiply=multiply_field(found.action_scale),
        **gain_fields(found.kp, found.kd),
    )
    observation = [_term(entry, pose, found.observation_clip) for entry in found.observation_layout or ()]
    rate = experiment.hertz if experiment else None
    return contract_fields(observation or None, "zeros", joint_names=joints, policy_hz=rate, action=action)


def _check_sizes(found: _Metadata, source: str) -> None:
    count = len(found.dof_names)
    for name in ("kp", "kd", "action_scale"):
        numbers = getattr(found, name)
        if isinstance(numbers, tuple) and len(numbers) != count:
            where = f"{source}: metadata {name!r}: found {len(numbers)} numbers"
            raise ContractError(f"{where}, expected {count}, one for each of dof_names")


def _term(entry: _Term, pose: list[float] | None, common: float | None) -> dict[str, Any]:
    return term_fields(
        entry.name,
        entry.func.rpartition(":")[2],
        pose,
        multiply=multiply_field(entry.scale),
        clip=_clip(entry.clip, common),
        clip_first=False,
        history=entry.history_length,
    )


def _pose(experiment: _Experiment, joints: list[str], source: str) -> list[float]:
    if missing := [name for name in joints if name not in experiment.pose]:
        raise ContractError(
            f"{source}: metadata 'experiment_config': default_joint_angles: found none for {missing[0]!r:.100}"
        )
    return [experiment.pose[name] for name in joints]


def _action(experiment: _Experiment, pose: list[float] | None) -> dict[str, Any]:
    """Return the action's fields; none unless joint positions are commanded."""
    terms = [action.func.rpartition(":")[2] for action in experiment.actions.values()]
    if experiment.control_type != "P" or terms != [POSITION]:
        return {}
    clip = [-experiment.clip_value, experiment.clip_value] if experiment.clip_actions else "none"
    return without_none(mode="position", offset=pose, clip=clip)


def _clip(own: tuple[float, float] | None, common: float | None) -> list[float] | None:
    """Return the tighter of the term's clip and the common clip, after scaling; None in files without the latter."""
    if common is None:
        return None
    low, high = own or (-common, common)
    return [max(low, -common), min(high, common)]
