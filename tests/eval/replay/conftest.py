import re
import shutil
from functools import cache

import pytest
from rich.console import Console

from robots.spec import ROBOTS, load_robot
from support.eval.bundles import ROBOTS_COUNTED, TICKS, first
from support.policies import policy_model, saved
from support.shared import made_once

PUSHES = {"force_n": (2000.0, 3000.0), "lasts_s": (0.1, 0.2), "every_s": (1.5, 2.0)}
"""What no robot withstands."""


@pytest.fixture(scope="session")
def pushed(tmp_path_factory):
    """A soak of 3.25 s of three arms that are thrown about, by their policy and by somebody else."""
    from support.eval.soaks import soak_config

    folder = tmp_path_factory.mktemp("pushed")
    robot = shutil.copytree(ROBOTS / "arm6", folder / "arm6")
    draws = (robot / "draws.toml").read_text()
    for name, (low, high) in PUSHES.items():
        draws = re.sub(rf"(?m)^{name} = .*$", f"{name} = {{ low = {low}, high = {high} }}", draws)
    (robot / "draws.toml").write_text(draws)
    spec, path = load_robot(robot), saved(policy_model(), folder)
    return soak_config(path, spec, hours=TICKS * spec.dt / 3600, robots=ROBOTS_COUNTED)


@pytest.fixture(scope="session")
def events(pushed, tmp_path_factory):
    """Bundles that its workers wrote."""
    from eval.soak.workers import run_soak

    soaked = made_once(
        tmp_path_factory, "pushed", lambda folder: run_soak(pushed, folder, Console(quiet=True))
    )
    return soaked / "events"


@pytest.fixture(scope="session")
def lived(events):
    """The bundle of a monitor and its window, lived again once for all who only look at it."""
    from eval.replay.replayer import Replay

    @cache
    def lived(monitor):
        replay = Replay(first(events, monitor))
        return replay, replay.run()

    return lived


@pytest.fixture
def one(events, tmp_path):
    """A copy of the bundle of an excess of a joint's speed."""
    return shutil.copytree(first(events, "velocity"), tmp_path / "one")
