"""Files of cases: what is read is what was written, and mistakes are named."""

import json

import pytest

from eval.attack.adversaries import ADVERSARIES
from eval.attack.candidate import Candidate, Case, check_weights, read_case
from eval.attack.suite import run_suite
from robots.errors import ConfigError
from support.arm6 import SPEC

PUSH = ADVERSARIES["push"].first(SPEC.n)
CASE = Case(
    robot="arm6",
    mode="position",
    faults=("bus silent",),
    monitor="torque",
    worst=0.93,
    adversary="push",
    seed=9,
    weights=dict(PUSH),
)


def test_case_is_read_as_it_was_written(tmp_path):
    CASE.write(tmp_path / "a.json")
    assert read_case(tmp_path / "a.json") == CASE
    assert CASE.candidate == Candidate("push", PUSH, 9)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"adversary": "rain"}, "adversary: found 'rain', expected one of anti_damping"),
        ({"mode": "thought"}, "mode: "),
        ({"seed": -1}, "seed: "),
        ({"monitor": "weather"}, "monitor: found 'weather', expected one of position_requested"),
        ({"weights": {"push": [float("nan")]}}, r"weights\.push\.0: "),
        ({"more": 1}, "more: "),
    ],
)
def test_wrong_field_of_a_case_is_named(change, complaint, tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(CASE.model_dump() | change))
    with pytest.raises(ConfigError, match=rf"a\.json: {complaint}"):
        read_case(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("weights", "complaint"),
    [
        ({"weather": (1.0,)}, "weights: found 'weather', expected some of reach"),
        ({"push": (1.0,)}, r"weights\.push: found 1 numbers, expected 6"),
        ({"push": (9.0,) * 6}, r"weights\.push: found 9 to 9, expected -2 to 2"),
    ],
)
def test_weights_of_no_adversary_are_refused(weights, complaint):
    with pytest.raises(ConfigError, match=f"here: {complaint}"):
        check_weights(weights, SPEC, "here")


def test_fault_of_no_class_is_refused(tmp_path):
    Case.model_validate(CASE.model_dump() | {"faults": ("bad luck",)}).write(tmp_path / "a.json")
    with pytest.raises(
        ConfigError, match=r"a\.json: faults: found 'bad luck', expected some of: encoder off"
    ):
        next(run_suite(tmp_path))


def test_folder_without_cases_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="found no case"):
        next(run_suite(tmp_path))
