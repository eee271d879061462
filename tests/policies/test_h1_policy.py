"""Unitree's own walking policy on its own robot, where both lie beside the project: no code was written for them."""

import shutil
from functools import partial

import numpy as np
import pytest

pytest.importorskip("torch")
SimRobot = pytest.importorskip("deploy.backends.sim.robot").SimRobot

from deploy.state import Mode
from eval.bench.trial import Trial
from eval.bench.walk import measure_walk
from policies.doctor import check_context
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Verdict
from policies.doctor.checklist import run_checks
from policies.doctor.simulation import simulated_run
from policies.importers.cli import import_policy
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.paths import SHARED, TEST_ROBOTS

VENDOR = SHARED / "peers" / "h1"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not VENDOR.is_dir(), reason="the vendor's files are not beside the project"),
]

ROBOTS, WALKED_S = 2, 60.0


@pytest.fixture(scope="module")
def h1(tmp_path_factory):
    """The robot's folder, with its policy in it."""
    folder = tmp_path_factory.mktemp("robots") / "h1"
    shutil.copytree(TEST_ROBOTS / "h1", folder)
    shutil.copyfile(VENDOR / "h1.xml", folder / "model.xml")
    shutil.copytree(VENDOR / "meshes", folder / "meshes")
    import_policy(VENDOR / "motion.pt", folder / "contract.toml", folder / "walk.onnx", folder)
    return folder


def test_robot_walks_for_a_minute_with_the_whole_stack(h1):
    spec, seeds = load_robot(h1), [robot_seed(7, robot) for robot in range(ROBOTS)]
    given = median_draw(load_distributions(spec), spec, ROBOTS)
    trial = Trial(spec, h1 / "walk.onnx", seeds, draw=given)
    found, counts = measure_walk(trial, WALKED_S), trial.judge.counts()
    assert (trial.runtime.supervisor.mode == Mode.RUNNING).all()
    assert not counts.stops.any()
    assert [m.name for m in counts.monitors if m.hard and counts.total(m.name)] == []
    assert counts.worst[:, counts.columns("tilt")].max() < 0.5
    assert (np.abs(found.forward_speed - 0.5) < 0.08).all()
    assert found.smoother_lag < 0.06
    assert counts.reached.sum() >= counts.attempted.sum() - ROBOTS  # the first begins at rest


def test_doctor_finds_nothing_wrong(h1, monkeypatch):
    """In simulations of 6 s with commands of 5 s, instead of 12 s and 10 s."""
    monkeypatch.setattr(simulated_run, "COMMAND_S", 5.0)
    monkeypatch.setattr(check_context, "run_simulation", partial(simulated_run.run_simulation, seconds=6.2))
    findings = list(run_checks(CheckContext(h1 / "walk.onnx", h1)))
    assert [finding.text for finding in findings if finding.verdict is Verdict.FAIL] == []
    said = {finding.check: finding.verdict for finding in findings}
    assert {
        said[name] for name in ("loader", "gains", "sources", "protection", "tilt", "first target", "heat")
    } == {Verdict.PASS}
