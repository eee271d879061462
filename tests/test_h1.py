"""Unitree's own walking policy on its own robot, where both lie beside the project: no code was written for them."""

import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
SimRobot = pytest.importorskip("deploy.backends.sim.robot").SimRobot

from deploy.policy import Policy  # noqa: E402
from deploy.runtime import Runtime  # noqa: E402
from deploy.state import Mode  # noqa: E402
from eval.monitors import Judge, of_base  # noqa: E402
from eval.shard import ARM_S, judge_tick  # noqa: E402
from policies.doctor.case import Case  # noqa: E402
from policies.doctor.checks import examined  # noqa: E402
from policies.doctor.finding import Verdict  # noqa: E402
from policies.doctor.life import middle  # noqa: E402
from policies.importing import import_policy  # noqa: E402
from robots.model_pinocchio import torque_max  # noqa: E402
from robots.randomness import robot_seed  # noqa: E402
from robots.spec import load_robot  # noqa: E402

VENDOR = Path(__file__).parents[2] / "shared" / "peers" / "h1"
pytestmark = pytest.mark.skipif(not VENDOR.is_dir(), reason="the vendor's files are not beside the project")

ROBOTS, WALKED_S = 2, 60.0


@pytest.fixture(scope="module")
def h1(tmp_path_factory):
    """The robot's folder, with its policy in it."""
    folder = tmp_path_factory.mktemp("robots") / "h1"
    shutil.copytree(Path(__file__).parent / "h1", folder)
    shutil.copyfile(VENDOR / "h1.xml", folder / "model.xml")
    shutil.copytree(VENDOR / "meshes", folder / "meshes")
    import_policy(VENDOR / "motion.pt", folder / "contract.toml", folder / "walk.onnx", folder)
    return folder


def test_it_walks_for_a_minute_through_the_whole_stack(h1):
    spec, everybody = load_robot(h1), np.ones(ROBOTS, dtype=bool)
    policy, seeds = Policy.load(h1 / "walk.onnx", spec), [robot_seed(7, robot) for robot in range(ROBOTS)]
    robot = SimRobot(spec, seeds, given=middle(spec, ROBOTS), gains=policy.contract.action.gains)
    runtime = Runtime(spec, policy.contract, robot, seeds, policy)
    judge = Judge(spec, torque_max(spec), ROBOTS, goal_s=spec.base.command_s)
    for _ in range(round(ARM_S / spec.dt)):
        runtime.tick()
    assert not runtime.arm(everybody).any()
    ticks = round(WALKED_S / spec.dt)
    walked, lag = np.zeros(ROBOTS), 0.0
    for _ in range(ticks):
        runtime.tick()
        truth = robot.truth()
        judge_tick(judge, truth, runtime, None)
        walked += of_base(truth.base)[0][:, 0]
        lag += np.abs(runtime.target.q - runtime.setpoint.q).mean()
    counts = judge.counts()
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    assert not counts.stops.any()
    assert [m.name for m in counts.monitors if m.hard and counts.total(m.name)] == []
    assert counts.worst[:, counts.columns("tilt")].max() < 0.5
    assert (np.abs(walked / ticks - 0.5) < 0.08).all()
    assert lag / ticks < 0.06
    assert counts.reached.sum() >= counts.attempted.sum() - ROBOTS  # the first begins at rest


def test_the_doctor_finds_nothing_that_speaks_against_it(h1):
    findings = list(examined(Case(h1 / "walk.onnx", h1)))
    assert [finding.said for finding in findings if finding.verdict is Verdict.FAIL] == []
    said = {finding.check: finding.verdict for finding in findings}
    assert {
        said[name] for name in ("loader", "gains", "sources", "protection", "tilt", "activation", "heat")
    } == {Verdict.PASS}
