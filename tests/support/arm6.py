import re
import shutil
from pathlib import Path

import pytest

from deploy.tasks.reach import Reach
from eval.judge.judge import Judge
from robots.errors import RobotError
from robots.spec import ROBOTS, load_robot

ARM = ROBOTS / "arm6"
SPEC = load_robot("arm6")


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


def complaint(folder):
    with pytest.raises(RobotError) as caught:
        load_robot(folder)
    return str(caught.value)
