import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from deploy.state import DriveMode
from deploy.tasks.reach import Reach
from eval.judge.judge import Judge
from robots.errors import RobotError
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.spec import ROBOTS, load_robot

ARM = ROBOTS / "arm6"
SPEC = load_robot("arm6")
NO_WORKSPACE = (
    (r"(?s)\[workspace\].*?tool_speed_max = 2.5", ""),
    ("workspace_m = 0.013", ""),
    ("workspace_m = 0.055", ""),
    ("tool_speed = 0.87", ""),
    ("tool_speed = 0.66", ""),
)
NO_TOOL = (*NO_WORKSPACE, ('tool = "tool" ', ""), ("singularity = 0.0005", ""))
NO_CLEARANCE = (("collision_m = 0.013\n", ""), ("collision_m = 0.045", ""))
"""Edits of robot.toml that take a capability from the arm."""


def copy_of_arm(folder, *, toml=(), xml=()):
    """The arm's folder with some text replaced: pairs (old, new), each old text found."""
    folder = Path(folder) / "robot"
    shutil.copytree(ARM, folder)
    for name, edits in (("robot.toml", toml), ("model.xml", xml)):
        path = folder / name
        text = path.read_text()
        for old, new in edits:
            assert re.search(old, text), f"{old!r} is not in {name}"
            text = re.sub(old, new, text, count=1)
        path.write_text(text)
    return folder


def arm_judge(torque_max, robots, **how):
    """A judge of the arm at its task."""
    return Judge(SPEC, torque_max, robots, criterion=Reach.success_criterion(SPEC), **how)


def position_drives(robots, spec=SPEC):
    """Drives that follow angles, with gains of their own."""
    gains = (np.tile(gain, (robots, 1)) for gain in drive_gains(spec))
    return DriveMode(np.full(robots, ControlMode.POSITION), *gains)


def complaint(folder):
    with pytest.raises(RobotError) as caught:
        load_robot(folder)
    return str(caught.value)
