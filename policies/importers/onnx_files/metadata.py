"""Metadata of ONNX files of mjlab, BeyondMimic and holosoma.

Source: mujocolab/mjlab, src/mjlab/rl/exporter_utils.py (1.6.0, and 1.4.0 without `observation_terms_...`) and
src/mjlab/managers/observation_manager.py; whole_body_tracking of BeyondMimic,
source/whole_body_tracking/whole_body_tracking/utils/exporter.py. Both write lists with commas and three decimals.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.draft_fields import (
    FAR,
    contract_fields,
    gain_fields,
    multiply_field,
    term_fields,
    without_none,
)
from policies.importers.onnx_files import holosoma
from robots.errors import ContractError
from robots.strict import PLACEHOLDER

CHARACTERS_MAX = 1 << 20
ENTRY = re.compile(r"[\[(][^\[\]()]*[\])]|[^,]+")
"""One entry of a list. Nested lists are 1;2 in mjlab 1.5.3, or [1, 2]."""
NAME = re.compile(r"[^\[\]{}\"',;]{1,100}")
VELOCITIES = (["twist"], ["base_velocity"])
"""Values of command_names if the only command is a velocity."""


def known_from(metadata: Mapping[str, str], source: str) -> dict[str, Any]:
    """Return the contract's fields known from ONNX metadata; `source` names the file in error messages."""
    if "dof_names" in metadata:
        return holosoma.known_from(metadata, source)
    if not metadata.keys() & {"joint_names", "observation_names"}:
        return {}
    lists = _MetadataLists(metadata, source)
    joints = lists.names("joint_names")
    pose = lists.numbers("default_joint_pos", joints)
    # There are as many actuated joints as gains; the metadata does not tell which ones.
    actuated = joints and joints[: len(lists.entries("joint_stiffness") or joints)]
    action, observation = _action(lists, actuated), _observation(lists, pose)
    unknown = {} if actuated == joints else {"action_joints": PLACEHOLDER}
    action |= {} if unknown else without_none(offset=pose)
    return contract_fields(observation, "first", joint_names=joints, action=action, **unknown)


def _action(lists: "_MetadataLists", actuated: list[str] | None) -> dict[str, Any]:
    kp, kd = (lists.numbers(key, actuated) for key in ("joint_stiffness", "joint_damping"))
    entries = lists.entries("action_scale") or ()
    scale = lists.numbers("action_scale", actuated if len(entries) > 1 else None)
    return without_none(mode="position", multiply=multiply_field(scale), **gain_fields(kp, kd))


class _MetadataLists:
    """Metadata values that are lists in text."""

    def __init__(self, metadata: Mapping[str, str], source: str) -> None:
        self._metadata, self._source = metadata, source

    def error(self, key: str, found: object, expected: str) -> ContractError:
        return ContractError(f"{self._source}: metadata {key!r}: found {found!r:.80}, expected {expected}")

    def entries(self, key: str) -> list[str] | None:
        """Return the entries of a list, or None if the key is missing."""
        text = self._metadata.get(key, "")
        entries = ENTRY.findall(text) if len(text) <= CHARACTERS_MAX else []
        if ",".join(entries) != text or len(entries) > SIZE_MAX:
            raise self.error(key, text, f"at most {SIZE_MAX} entries with commas between them")
        return entries or None

    def names(self, key: str) -> list[str] | None:
        """Return a list of names, or None if the key is missing."""
        names = self.entries(key)
        for name in names or ():
            if not NAME.fullmatch(name):
                raise self.error(key, name, "a name of at most 100 characters")
        return names

    def rows(self, key: str, expected_names: list[str] | None) -> list[list[float]] | None:
        """Return a list of number lists, one per name in `expected_names`, or None if the key is missing."""
        if (entries := self.entries(key)) is None:
            return None
        if expected_names is not None and len(entries) != len(expected_names):
            expected = f"{len(expected_names)} entries, one per name of {expected_names!r:.200}"
            raise self.error(key, self._metadata[key], expected)
        return [self._row(key, entry) for entry in entries]

    def _row(self, key: str, entry: str) -> list[float]:
        try:
            row = [float(number) for number in re.split("[;,]", entry.strip("[]()"))]
        except ValueError as e:
            raise self.error(key, entry, "numbers") from e
        if any(math.isnan(number) for number in row) or len(row) > SIZE_MAX:
            raise self.error(key, entry, f"at most {SIZE_MAX} numbers")
        return row

    def numbers(self, key: str, expected_names: list[str] | None) -> list[float] | None:
        """Return finite numbers, one per name in `expected_names`, or None if the key is missing."""
        rows = self.rows(key, expected_names)
        for row in rows or ():
            if len(row) != 1 or math.isinf(row[0]):
                raise self.error(key, row, "one finite number each")
        return None if rows is None else [row[0] for row in rows]


def _observation(lists: _MetadataLists, pose: list[float] | None) -> list[dict[str, Any]] | None:
    if (names := lists.names("observation_names")) is None:
        return None
    velocity = lists.names("command_names") in VELOCITIES
    unknown: list[Any] = [None] * len(names)
    scales = lists.rows("observation_terms_scale", names) or unknown
    clips, histories = _clips(lists, names), _histories(lists, names)
    return [
        term_fields(
            name,
            "velocity_command" if velocity and name == "command" else name,
            pose,
            multiply=multiply_field(scale),
            clip=clip,
            clip_first=True if clip else None,
            history=history,
        )
        for name, scale, clip, history in zip(names, scales, clips, histories, strict=True)
    ]


def _clips(lists: _MetadataLists, names: list[str]) -> Sequence[str | list[float] | None]:
    if (rows := lists.rows("observation_terms_clip", names)) is None:
        return [None] * len(names)
    for row in rows:
        if len(row) != 2 or not row[0] < row[1]:
            raise lists.error("observation_terms_clip", row, "low and high")
    return ["none" if row == [-math.inf, math.inf] else [max(row[0], -FAR), min(row[1], FAR)] for row in rows]


def _histories(lists: _MetadataLists, names: list[str]) -> Sequence[int | None]:
    """Return history lengths, of mjlab (0 means the newest reading only) or of BeyondMimic."""
    key = "observation_terms_history_length"
    lengths = lists.numbers(key, names) or lists.numbers("observation_history_lengths", names)
    flat = lists.numbers("observation_terms_flatten_history_dim", names) or [1.0] * len(names)
    for name, length, flattened in zip(names, lengths or (), flat, strict=False):
        if length not in range(SIZE_MAX + 1) or (length > 1 and not flattened):
            raise lists.error(key, (name, length, flattened), f"a length of 0 to {SIZE_MAX}, flattened")
    return [None] * len(names) if lengths is None else [max(1, int(length)) for length in lengths]
