"""Margins in robot.toml: written in place, with all comments kept."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomlkit

from deploy.telemetry.output_files import replacing
from eval.margins.derive import Need
from robots.errors import ConfigError, FirstshiftError
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec, load_robot

TOOL_SPEED, SOFT, TARGET = "tool_speed", "q_soft_rad", "q_target_rad"


def write_margins(spec: RobotSpec, needs: Mapping[ControlMode, Sequence[Need]]) -> Path:
    """Write the needed margins, those of position mode to [margins], those of others to tables of their own.

    Targets of angles stay as far inside soft limits as they were.

    Raises:
        ConfigError: the robot cannot have such margins; its file stays as it was.
        OutputError: the file cannot be written.
    """
    path = spec.folder / "robot.toml"
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    margins: Any = document["margins"]
    further = spec.margins.q_target_rad - spec.margins.q_soft_rad
    for mode, lacking in needs.items():
        for each in lacking:
            if each.key == TOOL_SPEED and TOOL_SPEED not in margins:
                _keep_tool_speeds(spec, margins)
            table = margins if mode is ControlMode.POSITION else _own_table(margins, mode)
            table[each.key] = each.needed
            if each.key == SOFT and mode is not ControlMode.TORQUE:
                margins[TARGET] = max(float(margins[TARGET]), round(each.needed + further, 6))
    text = tomlkit.dumps(document)
    _check(text, path)
    with replacing(path, "--write") as file:
        file.write_text(text, encoding="utf-8")
    return path


def _check(text: str, path: Path) -> None:
    """Refuse (ConfigError) a robot.toml that could not be loaded, before it takes the place of `path`."""
    with TemporaryDirectory() as folder:
        (Path(folder) / path.name).write_text(text, encoding="utf-8")
        try:
            load_robot(folder)
        except FirstshiftError as e:
            found = str(e).replace(folder, str(path.parent))
            raise ConfigError(f"the robot cannot have the margins that it needs: {found}") from e


def _keep_tool_speeds(spec: RobotSpec, margins: Any) -> None:
    """Write the tool speeds of all modes, which followed the joints' so far."""
    margins[TOOL_SPEED] = spec.margins.speed
    for mode in spec.control_modes:
        if mode is not ControlMode.POSITION:
            _own_table(margins, mode)[TOOL_SPEED] = spec.margins.of(mode).speed


def _own_table(margins: Any, mode: ControlMode) -> Any:
    return margins.setdefault(f"{mode.name.lower()}_mode", tomlkit.table())
