"""Sensors at the tool of planar4, the shipped robot that has them: distance, force and torque."""

import re
import subprocess
import sys

import numpy as np
import pytest

from deploy.sources.maximum import Scale
from deploy.sources.templates import physical_maxima
from deploy.tasks.task import sources_of
from support.deploy.exact_robots import exact_runtime, observe
from support.paths import ROOT
from support.planar import PLANAR3, PLANAR4, planar_contract

SOURCES = ("goal_distance", "tool_force", "tool_torque", "tool_position")
HAND_N, ARM_M = 0.3 * 9.81, 0.1
"""Weight of the hand, and how far its middle is behind the tool."""


def contract(**fields):
    return planar_contract(PLANAR4, "velocity", **fields)


@pytest.fixture(scope="module")
def runtime():
    """An exact arm that hangs at rest, stretched, with sensors as exact as they can be."""
    return exact_runtime(PLANAR4, contract, SOURCES)


def test_the_load_cell_holds_the_hand(runtime):
    """The tool's x axis lies in that of the world, and z points up."""
    seen = observe(runtime, 20)
    np.testing.assert_allclose(seen["tool_force"], [[0.0, 0.0, HAND_N]], atol=0.05)
    # The hand is held by a force at the tool and by a torque: what its middle, behind the tool, would turn down.
    np.testing.assert_allclose(seen["tool_torque"], [[0.0, HAND_N * ARM_M, 0.0]], atol=0.005)


@pytest.mark.parametrize("away", [(0.1, 0.0, 0.3), (-0.2, 0.0, -0.4), (0.05, 0.0, -0.05)])
def test_the_beam_measures_to_the_goal(runtime, away):
    tool = runtime.robot.truth().tool_position[0]
    runtime.robot.goal_source = lambda: (tool + away)[None]
    assert observe(runtime, 15)["goal_distance"] == pytest.approx(np.linalg.norm(away), abs=0.002)


def test_a_goal_behind_the_arm_reads_as_the_range(runtime):
    tool = runtime.robot.truth().tool_position[0]
    runtime.robot.goal_source = lambda: (tool - [0.6, 0.0, 0.0])[None]
    assert observe(runtime, 15)["goal_distance"] == pytest.approx(PLANAR4.sensors["distance"].range)


def test_readings_are_divided_by_their_ranges():
    sources, scale = sources_of("planar_reach"), Scale(PLANAR4, reach_m=0.9, leash_rad=0.3)
    found = {name: physical_maxima(name, sources[name], scale, "here") for name in SOURCES[:3]}
    assert found == {"goal_distance": (1.5,), "tool_force": (40.0,) * 3, "tool_torque": (2.0,) * 3}
    assert all("a sensor of kind" in sources[name].missing(PLANAR3) for name in SOURCES[:3])


def test_noise_of_the_distance_is_3_percent_of_its_range():
    sensor = PLANAR4.sensors["distance"]
    assert (sensor.rate_hz, sensor.noise / sensor.range) == (30, pytest.approx(0.03))


@pytest.mark.slow
def test_the_example_of_the_page_prints_them(tmp_path):
    pytest.importorskip("gymnasium")
    section = (ROOT / "docs" / "observation.md").read_text().split("## Print readings")[1].split("\n## ")[0]
    shell, example = re.search(r"```sh\n(.*?)```.*?```python\n(.*?)```", section, re.DOTALL).groups()
    shell = shell.replace("policies/", f"{ROOT}/policies/")
    subprocess.run(["bash", "-ec", shell], check=True, cwd=tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", example], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    lines = done.stdout.splitlines()
    assert [len(re.findall(r"-?\d+\.\d+", line)) for line in lines] == [7] * 20
