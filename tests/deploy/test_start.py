"""Starts of command lines: every script of pyproject.toml has one, and Ctrl-C while modules are imported is quiet."""

import ast
import tomllib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from deploy.start import INTERRUPTED, start
from support.paths import ROOT

SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


@pytest.mark.parametrize("script", SCRIPTS)
def test_script_starts_a_command_line(script):
    module, name = SCRIPTS[script].split(":")
    (command,) = getattr(import_module(module), name).args
    tree = ast.parse(Path(find_spec(command).origin).read_text())
    assert "cli" in {each.name for each in tree.body if isinstance(each, ast.FunctionDef)}


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Writer of a module that can be imported."""
    monkeypatch.syspath_prepend(tmp_path)
    return lambda name, text: (tmp_path / f"{name}.py").write_text(text)


def test_ctrl_c_during_imports_is_quiet(written, capsys):
    written("interrupted_command", "raise KeyboardInterrupt")
    with pytest.raises(SystemExit) as ended:
        start("interrupted_command")
    assert ended.value.code == INTERRUPTED
    assert capsys.readouterr() == ("", "")


def test_command_line_runs_once(written, capsys):
    written("other_command", "def cli():\n    print('ran')\n")
    start("other_command")
    assert capsys.readouterr().out == "ran\n"
