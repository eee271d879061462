"""A walking policy that Playground publishes, and the robot that mjlab ships, where that is installed."""

import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest

pytest.importorskip("torch")
tomlkit = pytest.importorskip("tomlkit")
SimRobot = pytest.importorskip("deploy.backends.sim.robot").SimRobot

from deploy.policy.policy import Policy
from deploy.state import Mode
from eval.bench.trial import Trial
from eval.bench.walk import measure_walk
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Verdict
from policies.doctor.checklist import run_checks
from policies.importers.cli import import_policy, write_template
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.paths import TEST_ROBOTS
from support.walking import QUADRUPED

pytestmark = pytest.mark.slow

FOLDER = TEST_ROBOTS / "go1"
PUBLISHED = FOLDER / "go1_policy.onnx"
MJLAB = find_spec("mjlab")
shipped = pytest.mark.skipif(MJLAB is None, reason="mjlab, which ships the Go1, is not installed")

ROBOTS, WALKED_S, STEPS = 2, 30.0, 40


def test_template_has_the_input_and_output_sizes(tmp_path):
    """tf2onnx names operators that it does not use, and a batch of one."""
    facts, still_open = write_template(PUBLISHED, tmp_path / "contract.toml")
    assert (facts.kind, facts.observations, facts.actions) == ("ONNX", 48, 12)
    assert still_open > 10


def test_policy_computes_the_same_on_another_quadruped(tmp_path):
    """Its joints stand in another order there."""
    document = tomlkit.parse((FOLDER / "contract.toml").read_text())
    document["robot"] = QUADRUPED.name
    side = {"R": "right", "L": "left"}
    part = {"hip": "abduction", "thigh": "hip", "calf": "knee"}
    theirs = [name.split("_")[:2] for name in document["joint_names"]]
    names = [joint_of(end, side[lr], part[kind]) for (end, lr), kind in theirs]
    document["joint_names"] = names
    draft = tmp_path / "contract.toml"
    draft.write_text(tomlkit.dumps(document))
    imported = import_policy(PUBLISHED, draft, tmp_path / "walk.onnx", QUADRUPED.folder)
    assert imported.deviation < 1e-5

    order = np.array([QUADRUPED.joint_names.index(name) for name in names])
    columns = np.concatenate([np.arange(9), 9 + order, 21 + order, 33 + order, [45, 46, 47]])
    rows = np.random.default_rng(0).normal(size=(STEPS, 48)).astype(np.float32)
    ours = np.empty_like(rows)
    ours[:, columns] = rows
    found = Policy.load(tmp_path / "walk.onnx", QUADRUPED).rehearse(ours, 1)[:, 0, order]
    session = ort.InferenceSession(PUBLISHED)
    expected = np.concatenate([session.run(None, {"obs": row[None]})[0] for row in rows])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    assert np.ptp(expected, axis=0).min() > 0.1


def joint_of(end, side, part):
    """The quadruped's name of a joint of the front or rear."""
    return f"{'front' if end == 'F' else 'rear'}_{side}_{part}"


@pytest.fixture(scope="module")
def go1(tmp_path_factory):
    """The robot's folder, with its policy in it."""
    folder = tmp_path_factory.mktemp("robots") / "go1"
    shutil.copytree(FOLDER, folder)
    vendor = Path(MJLAB.submodule_search_locations[0], "asset_zoo", "robots", "unitree_go1", "xmls")
    shutil.copyfile(vendor / "go1.xml", folder / "go1.xml")
    shutil.copytree(vendor / "assets", folder / "assets")
    import_policy(PUBLISHED, folder / "contract.toml", folder / "walk.onnx", folder)
    return folder


@shipped
def test_robot_walks_with_the_whole_stack(go1):
    spec, seeds = load_robot(go1), [robot_seed(7, robot) for robot in range(ROBOTS)]
    given = median_draw(load_distributions(spec), spec, ROBOTS)
    trial = Trial(spec, go1 / "walk.onnx", seeds, draw=given)
    found, counts = measure_walk(trial, WALKED_S), trial.judge.counts()
    assert (trial.runtime.supervisor.mode == Mode.RUNNING).all()
    assert not counts.stops.any()
    assert counts.worst[:, counts.columns("tilt")].max() < 0.5
    assert (np.abs(found.forward_speed - 0.5) < 0.08).all()
    # rad/s; three times that where joints were expected where they are sent
    assert found.joint_speed_error < 0.45


@shipped
def test_doctor_finds_the_untrained_delay_only(go1):
    """It was trained on drives that obey at once: 20 ms cost it goals."""
    findings = list(run_checks(CheckContext(go1 / "walk.onnx", go1)))
    said = {finding.check: finding for finding in findings}
    assert {name for name, finding in said.items() if finding.verdict is Verdict.FAIL} <= {"delay"}
    assert said["tilt"].verdict is Verdict.PASS
    assert "command" not in said["training"].text
