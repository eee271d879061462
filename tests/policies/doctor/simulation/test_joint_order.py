"""Joints that are exchanged or reversed inside a policy whose names are right: the doctor tries what would help."""

import json

import numpy as np
import onnx
import pytest

pytest.importorskip("mujoco")

from onnx import helper

from deploy.policy.policy import Policy
from deploy.policy.policy_names import CONTRACT_KEY
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Verdict
from policies.doctor.checklist import run_check
from policies.doctor.simulation import joint_order
from policies.doctor.simulation.joint_order import ROBOTS_PER_VARIANT, PermutedPolicy, joint_variants
from support.contracts import NAMES
from support.doctor import text_of
from support.faulty_policies import ailing, answering, in_another_order, in_front
from support.policies import metadata

pytestmark = pytest.mark.slow


@pytest.fixture
def brief_search(monkeypatch, one_goal):
    """Every third variant, reversals first: an exchange of elbow and wrist_3 reaches these goals, too."""

    def variants(names):
        as_it_is, *others = joint_variants(names)[::3]
        return [as_it_is, *reversed(others)]

    monkeypatch.setattr(joint_order, "joint_variants", variants)


EXCHANGED = [0, 2, 1, 3, 4, 5]


@pytest.fixture(scope="module")
def terms(shipped_policy):
    return json.loads(metadata(onnx.load(shipped_policy), CONTRACT_KEY).value)["observation"]


def reversed_joint(joint, terms):
    """A network trained with an axis that points the other way."""
    sign = np.where(np.arange(6) == joint, -1.0, 1.0).astype(np.float32)
    signs = [sign if each["frame"] == "joint" else np.ones(each["size"], np.float32) for each in terms]

    def change(model):
        answering(helper.make_node("Mul", ["said", "sign"], ["action"]), sign=sign)(model)
        in_front(helper.make_node("Mul", ["observation", "signs"], ["theirs"]), signs=np.concatenate(signs))(
            model
        )

    return change


@pytest.mark.usefixtures("brief_search")
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda terms: in_another_order(EXCHANGED, terms), "shoulder_lift and elbow exchanged"),
        (lambda terms: reversed_joint(2, terms), "elbow reversed"),
    ],
)
def test_helpful_exchange_is_named(shipped_policy, terms, tmp_path, change, said):
    case = CheckContext(ailing(shipped_policy, tmp_path, graph=change(terms)))
    assert run_check(case, "simulation").verdict is Verdict.FAIL
    found = text_of(case, "joint order", Verdict.WARN)
    assert f"with {said} it reaches 4 of 4 goals instead of 0" in found
    assert "change the joint names accordingly, and import or export it again" in found


@pytest.mark.usefixtures("brief_search")
def test_unhelpful_exchanges_are_not_named(arm_policy):
    """A policy that asks for nothing reaches nothing in any order."""
    found = text_of(CheckContext(arm_policy), "joint order", Verdict.WARN)
    assert "of 7 exchanges of two joints and reversals of one none helps" in found


def test_every_exchange_and_reversal_is_tried_once():
    tried = joint_variants(NAMES)
    assert len(tried) == 1 + 15 + 6
    assert len({(*places, *signs) for _, places, signs in tried}) == len(tried)
    assert tried[0].description == "as it is"


SCALES, OFFSETS = [1.3, 2.4, 2.65, 3.0, 2.6, 2.9], [0.1, -1.5, 1.4, -1.3, -1.2, 0.2]


def positions(order):
    """A contract with other numbers for every joint, written as if joints stood in `order`."""
    scales, offsets = ([numbers[k] for k in order] for numbers in (SCALES, OFFSETS))

    def change(data):
        data["observation"][0].update(scale=scales, offset=offsets)
        data["action"].update(
            mode="position", leash_rad=None, offset=offsets, scale=[0.1 * scale for scale in scales]
        )

    return change


def test_variant_with_the_wrong_order_equals_the_policy_itself(shipped_policy, terms, tmp_path):
    """Scales and offsets come with the wrong names, so that readings and targets must be brought to rad and back."""
    (tmp_path / "wrong").mkdir()
    right = CheckContext(ailing(shipped_policy, tmp_path, contract=positions(range(6))))
    order = in_another_order(EXCHANGED, terms)
    wrong = CheckContext(
        ailing(shipped_policy, tmp_path / "wrong", contract=positions(EXCHANGED), graph=order)
    )
    rng = np.random.default_rng(0)
    q, others = rng.uniform(-1.0, 1.0, (ROBOTS_PER_VARIANT, 6)), rng.normal(size=(ROBOTS_PER_VARIANT, 30))

    def target(case, policy):
        term, action = case.contract.observation[0], case.contract.action
        first = (q - term.offset) / term.scale
        observation = np.concatenate((first, others), axis=1).astype(np.float32)
        return np.array(action.offset) + np.array(action.scale) * policy.step(observation)

    exchanged = next(v for v in joint_variants(NAMES) if v.description == "shoulder_lift and elbow exchanged")
    found = target(wrong, PermutedPolicy(wrong.file, "wrong", [exchanged]))
    np.testing.assert_allclose(found, target(right, Policy(right.file, "right")), rtol=0, atol=1e-5)
    assert np.abs(found - target(wrong, wrong.policy)).max() > 0.1
