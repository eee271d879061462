"""The examples of docs/environments.md run as they are."""

import re
import subprocess
import sys

import pytest

from support.paths import ROOT

pytest.importorskip("gymnasium")
pytest.importorskip("stable_baselines3")

pytestmark = pytest.mark.slow

EXAMPLES = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "environments.md").read_text(), re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES)
def test_example_runs(example):
    command = [sys.executable, "-W", "error::DeprecationWarning", "-c", example]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")


def test_there_are_examples():
    assert len(EXAMPLES) == 3
