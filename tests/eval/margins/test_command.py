"""make margins as a command."""

import shutil
from contextlib import nullcontext

import pytest

pytest.importorskip("mujoco")

import eval.margins.__main__ as command
from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from eval.margins import trial
from robots.spec import load_robot
from support.planar import PLANAR3

QUICK = ("--mode", "position", "--trials", 1, "--generations", 1)


class InProcess:
    """A pool that does its work in this process."""

    def results(self, calls):
        return (call() for call in calls)


def margins(call, *words):
    return call(lambda: main(command.margins), *words)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--robot", "nobody"), "nobody"),
        (("--robot", "quadruped"), "--robot: found quadruped, whose drives may saturate"),
        (
            ("--robot", "planar3", "--mode", "thought"),
            "--mode: found 'thought', expected one of those of planar3",
        ),
        (("--generations", 0), "--generations: found 0, expected at least 1"),
        (("--trials", -1), "--trials: found -1, expected at least 1"),
        (("--workers", 0), "--workers: found 0, expected at least 1"),
    ],
)
def test_wrong_option_is_named(words, complaint, call):
    code, _, error = margins(call, *words)
    assert code == 2
    assert complaint in error


@pytest.mark.slow
def test_margins_that_do_not_suffice_are_written(call, tmp_path, monkeypatch):
    """As found by two adversaries in a second."""
    monkeypatch.setattr(trial, "TRIAL_S", 1.0)
    monkeypatch.setattr(command, "OF_MANY", command.OF_MANY[:2])
    monkeypatch.setattr(command, "processes", lambda _: nullcontext(InProcess()))
    folder = tmp_path / "a[/x]"
    shutil.copytree(PLANAR3.folder, folder)
    text = (folder / "robot.toml").read_text()
    (folder / "robot.toml").write_text(text.replace("q_soft_rad = 0.03", "q_soft_rad = 1e-6"))
    code, said, _ = margins(call, "--robot", folder, *QUICK, "--write")
    assert code == BUDGET_EXCEEDED
    assert "q_soft_rad" in said
    assert f"written: {folder / 'robot.toml'}" in said
    written = load_robot(folder).margins
    assert written.q_soft_rad > 1e-3
    assert margins(call, "--robot", folder, *QUICK)[0] == PASSED
