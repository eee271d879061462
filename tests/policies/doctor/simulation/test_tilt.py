"""Which way is down: small policies that balance, in our convention and in others."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from onnx import helper

from deploy.policy.contract import Observed
from deploy.policy.contract_action import ActionSpec
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Verdict
from policies.doctor.checklist import run_check
from policies.doctor.checks.observations import training
from support.contracts import arm_contract, term
from support.doctor import text_of
from support.faulty_policies import written

A = 4
UPRIGHT = {"projected_gravity": (0.0, 0.0, -1.0), "base_orientation": (1.0, 0.0, 0.0, 0.0)}
LEANING = {"projected_gravity": (0, 1), "base_orientation": (2, 1)}
"""Which numbers of the term change with leaning forwards and to the right."""


def balancing(folder, source="projected_gravity", *, even=False, gain=2.0, turned=None, mean=None, history=1):
    """A policy that stands still upright, and answers a lean by opposite actions of both its pairs of joints.

    Args:
        source: what tells it. turned: how training wrote that, if not as we do. mean: of observations in training.
        even: it answers leans to all sides alike. history: readings kept.
    """
    upright, size = np.array(UPRIGHT[source]), len(UPRIGHT[source])
    weights = np.zeros((size, A))
    for lean, place in enumerate(LEANING[source]):
        weights[place, 2 * lean : 2 * lean + 2] = gain, -gain
    tall = np.flatnonzero(upright)[0]
    weights[tall] = 0.75 * gain  # a robot that lies on its back struggles
    order = np.arange(size) if turned != "xyzw" else np.array([1, 2, 3, 0])
    sign = -1.0 if turned == "sign" else 1.0
    weights = sign * weights[order]
    bias = -(sign * upright[order]) @ weights
    columns = np.arange(size * (history - 1), size * history)
    nodes = [helper.make_node("Gather", ["observation", "columns"], ["newest"], axis=1)]
    nodes.append(helper.make_node("Gemm", ["newest", "w", "b"], ["said" if even else "action"]))
    nodes += [helper.make_node("Abs", ["said"], ["action"])] if even else []
    arrays = {"w": weights.astype(np.float32), "b": bias.astype(np.float32), "columns": columns}
    contract = arm_contract(
        observation=(term(source, size, scale=(1.0,) * size, history=history),),
        action=ActionSpec(mode="position", size=A, offset=(0.0,) * A, scale=(0.25,) * A, clip=None),
        observed=None if mean is None else Observed(mean=mean, deviation=(0.1,) * (size * history)),
    )
    return CheckContext(written(folder, nodes, arrays, contract), "arm6")


@pytest.mark.parametrize("source", UPRIGHT)
@pytest.mark.parametrize("history", [1, 3])
def test_policy_with_our_gravity_convention_passes(tmp_path, source, history):
    found = text_of(balancing(tmp_path, source, history=history), "tilt", Verdict.PASS)
    assert "opposite tilts with opposite actions; upright 0." in found


@pytest.mark.parametrize(
    ("source", "turned", "said"),
    [
        (
            "projected_gravity",
            "sign",
            "upright its actions are smaller with gravity with the other sign, +1 upright",
        ),
        ("base_orientation", "xyzw", "upright its actions are smaller with the quaternion as x, y, z, w"),
    ],
)
def test_policy_of_another_gravity_convention_is_recognized(tmp_path, source, turned, said):
    assert said in text_of(balancing(tmp_path, source, turned=turned), "tilt", Verdict.WARN)


def test_working_policy_is_not_suspected(tmp_path, monkeypatch):
    """Upright and at rest a policy that walks may be calmer with anything."""
    case = balancing(tmp_path, turned="sign")
    monkeypatch.setattr(CheckContext, "works", True)
    assert run_check(case, "tilt").verdict is Verdict.PASS


@pytest.mark.parametrize(
    ("source", "mean", "said"),
    [
        ("projected_gravity", (0.0, 0.0, 0.98), "third number was 0.98 in the mean, expected -1 upright"),
        ("base_orientation", (0.0, 0.0, 0.1, 0.95), "fourth number was 0.95 in the mean and its first 0.00"),
    ],
)
def test_training_statistics_reveal_the_convention(tmp_path, source, mean, said):
    assert said in text_of(balancing(tmp_path, source, mean=mean), "tilt", Verdict.FAIL)
    text_of(balancing(tmp_path, source, mean=UPRIGHT[source]), "tilt", Verdict.PASS)


def test_policy_without_gravity_observation(tmp_path):
    found = text_of(balancing(tmp_path, gain=0.01), "tilt", Verdict.WARN)
    assert found.count("rad changes actions by 0.002 at most: it does not respond to tilt") == 2


def test_policy_with_the_same_response_to_every_tilt(tmp_path):
    found = text_of(balancing(tmp_path, even=True), "tilt", Verdict.WARN)
    assert "tilting forwards and backwards gives similar" in found
    assert "tilting right and left gives similar" in found


def test_fixed_base_is_not_checked(arm_policy):
    found = run_check(CheckContext(arm_policy), "tilt")
    assert (found.verdict, found.text[:14]) == (Verdict.PASS, "does not apply")


def test_history_in_another_layout_is_named(tmp_path):
    """Three frames of gravity: ours stand one after the other, theirs number by number."""
    ours, theirs = (0.0, 0.0, -1.0) * 3, (0.0,) * 6 + (-1.0,) * 3
    note = next(training(balancing(tmp_path, mean=theirs, history=3)))
    assert note.verdict is Verdict.WARN
    assert "frames of its history differ by more than a deviation of training" in note.text
    assert (
        run_check(balancing(tmp_path, mean=ours, history=3), "training").text
        == "not tried: see row simulation."
    )


def test_terms_of_one_source_that_differ_in_size_are_named(tmp_path):
    known = term("projected_gravity", 3, scale=(1.0,) * 3)
    odd = known.model_copy(update={"name": "odd", "size": 2, "scale": (1.0,) * 2})
    contract = arm_contract(observation=(odd, known))
    nodes = [helper.make_node("MatMul", ["observation", "w"], ["action"])]
    weights = np.ones((contract.observation_size, contract.action_size), np.float32)
    found = run_check(CheckContext(written(tmp_path, nodes, {"w": weights}, contract), "arm6"), "tilt")
    assert (found.verdict, found.text) == (
        Verdict.FAIL,
        "odd: projected_gravity has 2 numbers here and 3 in another term.",
    )
