"""Some mutations of the files of every importer: a short `make fuzz`."""

import pytest

pytest.importorskip("torch")
pytest.importorskip("tomlkit")
pytest.importorskip("rsl_rl.models")
pytest.importorskip("stable_baselines3")

from eval.fuzz.targets import TARGETS as WITHOUT_TORCH
from policies.fuzz.targets import TARGETS
from support.eval.fuzzed import check_cases

pytestmark = pytest.mark.slow

CASES = {"ONNX": 40, "VecNormalize": 40, "checkpoint": 40, "texts": 40}
OTHERS = 2
"""Cases of readers that trace a network."""


@pytest.mark.parametrize("name", [name for name in TARGETS if name not in WITHOUT_TORCH])
def test_mutations_are_read_or_refused(tmp_path, name):
    check_cases(TARGETS, name, tmp_path, CASES.get(name, OTHERS))
