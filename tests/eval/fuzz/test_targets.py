"""Some mutations of the files of every reader: a short `make fuzz`."""

import pytest

pytest.importorskip("mujoco")

from eval.fuzz.targets import TARGETS
from support.eval.fuzzed import check_cases

SLOW = {"MJCF": 3, "bundle": 3}
"""Cases of readers that compile a model in a process of its own."""
CASES = 60


@pytest.mark.parametrize("name", [name for name in TARGETS if name not in SLOW])
def test_mutations_are_read_or_refused(tmp_path, name):
    check_cases(TARGETS, name, tmp_path, CASES)


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_mutations_of_models_and_bundles_are_read_or_refused(tmp_path, name):
    check_cases(TARGETS, name, tmp_path, SLOW[name])
