"""What ONNX files of the field say of themselves: the metadata of mjlab, BeyondMimic and holosoma.

Source: mujocolab/mjlab, src/mjlab/rl/exporter_utils.py (1.6.0, and 1.4.0 without `observation_terms_...`) and
src/mjlab/managers/observation_manager.py; whole_body_tracking of BeyondMimic,
source/whole_body_tracking/whole_body_tracking/utils/exporter.py. Both write lists with commas and three decimals.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

from deploy.policy.observation_terms import SIZE_MAX
from policies.importers.draft_fields import contract, factors, gains, said, term
from policies.importers.onnx_files import holosoma
from robots.errors import ContractError
from robots.strict import OPEN

CHARACTERS_MAX = 1 << 20
ENTRY = re.compile(r"[\[(][^\[\]()]*[\])]|[^,]+")
"""Lists inside a list: 1;2 by mjlab 1.5.3, and [1, 2] as Python writes them."""
NAME = re.compile(r"[^\[\]{}\"',;]{1,100}")
VELOCITIES = (["twist"], ["base_velocity"])
"""Names of the one command that is a velocity."""
FAR = 1e30
"""Stands for no bound, where the other side has one."""


def known_from(metadata: Mapping[str, str], source: str) -> dict[str, Any]:
    """Fields of the contract's TOML that the metadata of an ONNX file says; `source` names the file in messages.

    Raises:
        ContractError: one line naming the key, the value found and what was expected.
    """
    if "dof_names" in metadata:
        return holosoma.known_from(metadata, source)
    if not metadata.keys() & {"joint_names", "observation_names"}:
        return {}
    table = _Table(metadata, source)
    joints = table.names("joint_names")
    pose = table.numbers("default_joint_pos", joints)
    driven = _driven(table, joints)
    kp, kd = (table.numbers(key, driven) for key in ("joint_stiffness", "joint_damping"))
    scale = table.numbers("action_scale", driven if "," in metadata.get("action_scale", "") else None)
    action = said(mode="position", multiply=factors(scale), **gains(kp, kd))
    observation = _observation(table, pose)
    if driven != joints:
        return contract(observation, "first", joint_names=joints, action_joints=OPEN, action=action)
    return contract(observation, "first", joint_names=joints, action=said(offset=pose, **action))


def _driven(table: "_Table", joints: list[str] | None) -> list[str] | None:
    """As many of the joints as have gains: which those are the metadata does not say."""
    count = len(table.entries("joint_stiffness") or joints or ())
    return joints[:count] if joints else joints


class _Table:
    """Lists in text."""

    def __init__(self, metadata: Mapping[str, str], source: str) -> None:
        self._metadata, self._source = metadata, source

    def error(self, key: str, found: object, expected: str) -> ContractError:
        return ContractError(f"{self._source}: metadata {key!r}: found {found!r:.80}, expected {expected}")

    def entries(self, key: str) -> list[str] | None:
        """None: not said."""
        text = self._metadata.get(key, "")
        entries = ENTRY.findall(text) if len(text) <= CHARACTERS_MAX else []
        if ",".join(entries) != text or len(entries) > SIZE_MAX:
            raise self.error(key, text, f"at most {SIZE_MAX} entries with commas between them")
        return entries or None

    def names(self, key: str) -> list[str] | None:
        """None: not said."""
        names = self.entries(key)
        for name in names or ():
            if not NAME.fullmatch(name):
                raise self.error(key, name, "a name of at most 100 characters")
        return names

    def rows(self, key: str, each: list[str] | None) -> list[list[float]] | None:
        """Numbers, one entry for each of some names; None: not said."""
        if (entries := self.entries(key)) is None:
            return None
        if each is not None and len(entries) != len(each):
            raise self.error(key, self._metadata[key], f"{len(each)} entries, one for each of {each!r:.200}")
        return [self._row(key, entry) for entry in entries]

    def _row(self, key: str, entry: str) -> list[float]:
        try:
            row = [float(number) for number in re.split("[;,]", entry.strip("[]()"))]
        except ValueError as e:
            raise self.error(key, entry, "numbers") from e
        if any(math.isnan(number) for number in row) or len(row) > SIZE_MAX:
            raise self.error(key, entry, f"at most {SIZE_MAX} numbers")
        return row

    def numbers(self, key: str, each: list[str] | None) -> list[float] | None:
        """Finite, one for each of some names; None: not said."""
        rows = self.rows(key, each)
        for row in rows or ():
            if len(row) != 1 or math.isinf(row[0]):
                raise self.error(key, row, "one finite number for each")
        return None if rows is None else [row[0] for row in rows]


def _observation(table: _Table, pose: list[float] | None) -> list[dict[str, Any]] | None:
    if (names := table.names("observation_names")) is None:
        return None
    velocity = table.names("command_names") in VELOCITIES
    words = ["velocity_command" if velocity and name == "command" else name for name in names]
    scales = table.rows("observation_terms_scale", names)
    clips = _clips(table, names)
    histories = _histories(table, names)
    return [
        term(
            name,
            words[k],
            pose,
            multiply=factors(scales[k] if scales else None),
            clip=clips[k] if clips else None,
            clip_first=True if clips else None,
            history=histories[k] if histories else None,
        )
        for k, name in enumerate(names)
    ]


def _clips(table: _Table, names: list[str]) -> list[str | list[float]] | None:
    if (rows := table.rows("observation_terms_clip", names)) is None:
        return None
    for row in rows:
        if len(row) != 2 or not row[0] < row[1]:
            raise table.error("observation_terms_clip", row, "low and high")
    return ["none" if row == [-math.inf, math.inf] else [max(row[0], -FAR), min(row[1], FAR)] for row in rows]


def _histories(table: _Table, names: list[str]) -> list[int] | None:
    """Lengths: mjlab's, in which 0 is none but the newest, or BeyondMimic's."""
    key = "observation_terms_history_length"
    lengths = table.numbers(key, names) or table.numbers("observation_history_lengths", names)
    flat = table.numbers("observation_terms_flatten_history_dim", names) or [1.0] * len(names)
    for name, length, flattened in zip(names, lengths or (), flat, strict=False):
        if length not in range(SIZE_MAX + 1) or (length > 1 and not flattened):
            raise table.error(key, (name, length, flattened), f"0 to {SIZE_MAX}, and flattened")
    return None if lengths is None else [max(1, int(length)) for length in lengths]
