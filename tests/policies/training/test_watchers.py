"""What policy-train shows of a training."""

import re

import numpy as np
import pytest

pytest.importorskip("torch")
av = pytest.importorskip("av")

from policies.training.cli import cli as policy_train
from policies.training.recipe import find_recipe
from policies.training.watchers import JointSpeeds
from support.arm6 import SPEC

pytestmark = pytest.mark.slow


@pytest.fixture
def tiny(tmp_path):
    """A recipe of ten iterations with four robots."""
    head, _, _ = find_recipe("arm").read_text(encoding="utf-8").partition("[[learner.stages]]")
    for name, value in {"robots": 4, "goals_per_episode": 1, "num_steps_per_env": 8}.items():
        head = re.sub(f"{name} = .*", f"{name} = {value}", head)
    path = tmp_path / "tiny.toml"
    path.write_text(head + "[[learner.stages]]\niterations = 10\nlearning_rate = 1e-3\n")
    return path


def test_training_prints_joint_speeds_and_films_the_policy(call, tiny, tmp_path):
    film = tmp_path / "a.mp4"
    code, said, complaint = call(policy_train, "--recipe", tiny, "--out", tmp_path / "out", "--video", film)
    if "needs OpenGL" in complaint:
        pytest.skip(complaint)
    assert code == 0
    lines = [line for line in said.splitlines() if line.startswith("largest joint speeds")]
    assert len(lines) == 3  # every 80 steps of training, and of an episode of 200 after it
    for name in SPEC.joint_names:
        assert all(0 < int(re.search(rf"{name} (\d+)%", line)[1]) <= 100 for line in lines)
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert float(container.streams.video[0].average_rate) == pytest.approx(25)
    assert len(frames) == 100  # an episode of one goal of 4 s
    assert np.abs(frames[0].astype(float) - frames[-1]).max() > 50


def test_joint_speeds_are_the_largest_since_the_last_line(capsys):
    class Peaks:
        peak_qd = np.zeros((2, SPEC.n))

    speeds = JointSpeeds(Peaks, SPEC, 2)
    Peaks.peak_qd[1, 0] = SPEC.joint_array("qd_max")[0] / 2
    speeds()
    assert capsys.readouterr().out == ""
    speeds()
    name, others = SPEC.joint_names[0], SPEC.joint_names[1:]
    expected = ", ".join([f"{name} 50%", *(f"{other} 0%" for other in others)])
    assert capsys.readouterr().out == f"largest joint speeds, of their limits: {expected}\n"
    assert not Peaks.peak_qd.any()


REFUSED = {
    "suffix": (("--video", "a.avi"), "found .avi, expected .gif or .mp4"),
    "display": (("--view",), "--view: found neither DISPLAY nor WAYLAND_DISPLAY, expected a display"),
}


@pytest.mark.parametrize(("options", "message"), REFUSED.values(), ids=REFUSED)
def test_wrong_option_is_refused(call, tiny, tmp_path, monkeypatch, options, message):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    code, _, complaint = call(policy_train, "--recipe", tiny, "--out", tmp_path / "out", *options)
    assert code == 2
    assert message in complaint


def test_a_recipe_for_an_unknown_robot_is_refused(call, tiny, tmp_path):
    tiny.write_text(tiny.read_text().replace('robot = "arm6"', 'robot = "arm7"'))
    code, _, complaint = call(policy_train, "--recipe", tiny, "--out", tmp_path / "out")
    assert code == 2
    assert f"{tiny}: robot arm7: no such folder with a robot.toml; known: arm6, " in complaint
