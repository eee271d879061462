"""Margins in robot.toml: written in place, with all comments kept."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import tomlkit

from deploy.telemetry.output_files import replacing
from eval.margins.derive import Need
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec


def write_margins(spec: RobotSpec, needs: Mapping[ControlMode, Sequence[Need]]) -> Path:
    """Write the needed margins, those of position mode to [margins], those of others to tables of their own.

    Where soft limits of position mode move inward, targets move with them.

    Raises:
        OutputError: the file cannot be written.
    """
    path = spec.folder / "robot.toml"
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    margins = document["margins"]
    for mode, lacking in needs.items():
        own = margins if mode is ControlMode.POSITION else _own_table(margins, mode)
        for each in lacking:
            if each.key == "q_soft_rad" and own is margins:
                further = each.needed - float(margins["q_soft_rad"])
                margins["q_target_rad"] = round(float(margins["q_target_rad"]) + further, 6)
            own[each.key] = each.needed
    with replacing(path) as file:
        file.write_text(tomlkit.dumps(document), encoding="utf-8")
    return path


def _own_table(margins: tomlkit.items.Table, mode: ControlMode) -> tomlkit.items.Table:
    return margins.setdefault(f"{mode.name.lower()}_mode", tomlkit.table())
