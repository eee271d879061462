"""Files of cases: what is read is what was written, and mistakes are named."""

import json

import pytest

from eval.attack.adversaries import ADVERSARIES
from eval.attack.candidate import Candidate, Case, check_weights, read_case
from eval.attack.suite import run_suite
from robots.errors import ConfigError
from robots.spec import load_robot
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
    ("change", "complaint"),
    [
        ({"weather": (1.0,)}, "weights: found '.*weather', expected reach, "),
        ({"push": (1.0,)}, r"weights\.push: found 1 numbers, expected 6"),
        ({"push": (9.0,) * 6}, r"weights\.push: found 9 to 9, expected -2 to 2"),
        ({"delay": (2.5,)}, r"weights\.delay: found 2.5, expected a whole number"),
    ],
)
def test_wrong_weights_are_refused(change, complaint):
    adversary = "replay" if "delay" in change else "push"
    weights = {**ADVERSARIES[adversary].first(SPEC.n), **change}
    with pytest.raises(ConfigError, match=f"here: {complaint}"):
        check_weights(Candidate(adversary, weights, 9), SPEC, "here")


def test_weights_that_are_left_out_are_missed():
    with pytest.raises(ConfigError, match=r"here: weights: found '', expected reach, "):
        check_weights(Candidate("push", {}, 9), SPEC, "here")


def test_fault_of_no_class_is_refused(tmp_path):
    Case.model_validate(CASE.model_dump() | {"faults": ("bad luck",)}).write(tmp_path / "a.json")
    with pytest.raises(
        ConfigError, match=r"a\.json: faults: found 'bad luck', expected some of: encoder off"
    ):
        next(run_suite(tmp_path))


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, "faults bus silent"),
        ({"faults": (), "robot": "quadruped"}, "quadruped, which has a floating base"),
    ],
)
def test_pushed_arm_with_a_fault_or_without_a_fixed_base_is_refused(change, found, tmp_path):
    weights = ADVERSARIES["loaded_arm"].first(load_robot(change.get("robot", "arm6")).n)
    case = CASE.model_dump() | {"adversary": "loaded_arm", "weights": weights} | change
    Case.model_validate(case).write(tmp_path / "a.json")
    with pytest.raises(ConfigError, match=rf"a\.json: adversary: found loaded_arm with {found}, expected a"):
        next(run_suite(tmp_path))


def test_folder_without_cases_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="found no case"):
        next(run_suite(tmp_path))
