"""Starts of command lines: every script of pyproject.toml has one, and Ctrl-C while modules are imported is quiet."""

import ast
import os
import subprocess
import sys
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


def run(module, folder, **environment):
    """Start a module of a folder in a process of its own."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"  # a shell may ignore it
        f"sys.path.insert(0, {str(folder)!r}); from deploy.start import start; start({module!r})"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, timeout=60, check=False
    )


def test_ctrl_c_during_imports_is_quiet(written, tmp_path):
    """Be it in a module that makes another exception of it, as C extensions do."""
    written(
        "interrupted_command",
        "import os, signal\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n"
        "except BaseException:\n    raise ImportError\n",
    )
    ended = run("interrupted_command", tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, b"", b"")


def test_ctrl_c_is_an_exception_again_when_the_command_runs(written, tmp_path):
    written(
        "patient_command",
        "import os, signal\ndef cli():\n    try:\n        os.kill(os.getpid(), signal.SIGINT)\n"
        "    except KeyboardInterrupt:\n        print('stopped')\n",
    )
    assert run("patient_command", tmp_path).stdout == b"stopped\n"


@pytest.mark.parametrize(
    "environment",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
    ids=["encoding", "locale"],
)
def test_letters_that_a_terminal_lacks_are_escaped(written, tmp_path, environment):
    written("greek_command", "def cli():\n    print('5 \u00b5s \u2264 6')\n")
    ended = run("greek_command", tmp_path, **environment)
    assert (ended.returncode, ended.stdout) == (0, b"5 \\xb5s \\u2264 6\n")


def test_command_line_runs_once(written, capsys):
    written("other_command", "def cli():\n    print('ran')\n")
    start("other_command")
    assert capsys.readouterr().out == "ran\n"
