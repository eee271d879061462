"""A draft in the policy's order, and what our runtime makes of it: the owner's own loop is the oracle."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.policy.action import Action
from deploy.policy.compatibility import check_contract
from deploy.policy.observation import Observation
from policies.importers.contract_builder import build_contract
from policies.importers.contract_draft import ContractDraft
from policies.importers.reference_policy import ABSENT, PolicyFacts
from robots.errors import ContractError
from robots.strict import parse
from support.arm6 import SPEC, position_drives
from support.contracts import NAMES

THEIRS = tuple(NAMES[k] for k in (3, 0, 5, 1, 4, 2))
POSE = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)
ROBOTS, STEPS = 2, 7


def drafted(history=1, **changes):
    """A draft as its owner would write it, joints in their own order."""
    once = {"clip": "none", "history": history}
    terms = [
        {"name": "q", "source": "joint_position", "offset": POSE, "multiply": 2.0, **once},
        {"name": "qd", "source": "joint_velocity", "offset": "none", "multiply": 0.05, **once}
        | {"clip": (-4.0, 4.0), "clip_first": True},
        {"name": "goal", "source": "goal_position", "offset": "none", "multiply": (1.0, 2.0, 3.0), **once}
        | {"clip": (-0.5, 0.6), "clip_first": False},
        {"name": "last", "source": "last_action", "offset": "none", "multiply": 1, **once},
    ]
    action = {
        "mode": "position",
        "offset": POSE,
        "multiply": 0.25,
        "clip": "none",
        "kp": "none",
        "kd": "none",
    }
    fields = {"robot": "arm6", "task": "reach", "policy_hz": 50, "joint_names": THEIRS}
    return {**fields, "observation": tuple(terms), "action": action, **changes}


def settled(data, observations=None, actions=6, **original):
    draft = parse(data, ContractDraft, source="x.toml", error=ContractError)
    total = sum(t.history * (3 if t.source == "goal_position" else 6) for t in draft.observation)
    facts = PolicyFacts(kind="a test", observations=observations or total, actions=actions)
    known = {"mean": None, "deviation": None, "memory_size": 0, **original}
    return build_contract(draft, SimpleNamespace(facts=facts, **known), SPEC, "x.toml")


class Owner:
    """How a policy's owner puts an observation together, joint by joint, by name."""

    def __init__(self, layout, frames, fill):
        self.layout, self.frames, self.fill, self.kept = layout, frames, fill, []

    def see(self, readings, history):
        pose = dict(zip(THEIRS, POSE, strict=True))
        parts = [
            [(readings["joint_position"][name] - pose[name]) * 2.0 for name in THEIRS],
            [float(np.clip(readings["joint_velocity"][name], -4, 4)) * 0.05 for name in THEIRS],
            [float(np.clip(x * (k + 1), -0.5, 0.6)) for k, x in enumerate(readings["goal_position"])],
            [readings["last_action"][name] for name in THEIRS],
        ]
        if not self.kept:
            first = parts if self.fill == "first" else [[0.0] * len(part) for part in parts]
            self.kept = [first] * history
        self.kept = [*self.kept[1:], parts]
        frames = self.kept if self.frames == "oldest_first" else self.kept[::-1]
        if self.layout == "by_time":
            return [x for frame in frames for part in frame for x in part]
        return [x for k in range(len(parts)) for frame in frames for x in frame[k]]


@pytest.mark.parametrize(
    ("history", "layout", "frames", "fill"),
    [
        (1, "by_term", "oldest_first", "first"),
        *product([3], ["by_term", "by_time"], ["oldest_first", "newest_first"], ["first", "zeros"]),
    ],
)
def test_observation_equals_the_original_in_another_order(history, layout, frames, fill):
    result = settled(drafted(history, layout=layout, frames=frames, fill=fill))
    check_contract(result.contract, SPEC, "x.toml")
    rng = np.random.default_rng(history)
    now = {name: rng.normal(size=(ROBOTS, 6)) for name in ("joint_position", "joint_velocity", "last_action")}
    now["goal_position"] = rng.normal(size=(ROBOTS, 3))
    ours = Observation(result.contract, {name: lambda name=name: now[name] for name in now}, ROBOTS)
    owners = [Owner(layout, frames, fill) for _ in range(ROBOTS)]
    for _ in range(STEPS):
        for name, reading in now.items():
            reading[:] = rng.normal(size=reading.shape) * (10 if name == "joint_velocity" else 1)
        found = ours.step()[:, result.columns]
        for robot, owner in enumerate(owners):
            readings = {
                name: reading[robot]
                if name == "goal_position"
                else dict(zip(NAMES, reading[robot], strict=True))
                for name, reading in now.items()
            }
            np.testing.assert_allclose(found[robot], owner.see(readings, history), rtol=1e-6, atol=1e-7)


def test_targets_equal_the_original():
    multiply = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    result = settled(drafted(action=drafted()["action"] | {"multiply": multiply, "clip": (-2.0, 2.0)}))
    theirs = np.random.default_rng(0).normal(size=(1, 6)) * 3
    action = Action(result.contract.action, position_drives(1))
    target = action.step(theirs[:, result.joints], np.zeros((1, 6))).value[0]
    for k, name in enumerate(THEIRS):
        expected = POSE[k] + multiply[k] * np.clip(theirs[0, k], -2, 2)
        assert target[NAMES.index(name)] == pytest.approx(expected, rel=1e-12)


def test_training_statistics_are_reordered():
    seen = tuple(float(k + 1) for k in range(21))
    result = settled(drafted(), mean=seen, deviation=seen)
    assert np.array(result.contract.observed.mean)[result.columns].tolist() == list(seen)


def without(key, term=None):
    data = drafted()
    if term is None:
        return {k: v for k, v in data.items() if k != key}
    terms = [dict(t) for t in data["observation"]]
    del terms[term][key]
    return data | {"observation": tuple(terms)}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (without("policy_hz"), "x.toml: policy_hz: Field required"),
        (without("offset", 0), "x.toml: observation.0.offset: Field required"),
        (
            without("clip_first", 1),
            "observation 'qd': clip_first: missing, expected true (clip before multiply) or false",
        ),
        (drafted(history=2), "x.toml: layout: missing, required where a term has a history"),
        (
            drafted(joint_names=("elbo", *THEIRS[1:])),
            "joint_names: arm6 has no joint 'elbo', expected one of elbow",
        ),
        (
            drafted(joint_names=(THEIRS[1], *THEIRS[1:])),
            f"joint_names: found '{THEIRS[1]}' 2 times, expected once",
        ),
        (drafted(joint_names=THEIRS[:5]), f"joint_names: found '{THEIRS[5]}' 0 times, expected once"),
        (
            drafted(action=drafted()["action"] | {"multiply": (1.0, 2.0)}),
            "x.toml: action: multiply: found 2 numbers, expected 1 or 6",
        ),
        (
            drafted(action=drafted()["action"] | {"multiply": 0.0}),
            "action.multiply.0: Input should be greater than 0",
        ),
    ],
)
def test_invalid_draft_names_its_field(data, message):
    with pytest.raises(ContractError) as caught:
        settled(data)
    assert message in str(caught.value)
    assert str(caught.value).startswith("x.toml: ")


def still(**changes):
    """The policy sees a finger that the robot has not, between the others, and moves joints in another order."""
    terms = [dict(each) for each in drafted()["observation"]]
    terms[0]["offset"] = (*POSE[:2], 7.0, *POSE[2:])
    names = (*THEIRS[:2], "finger", *THEIRS[2:])
    return drafted(joint_names=names, action_joints=THEIRS[::-1], observation=tuple(terms)) | changes


def test_missing_joint_is_observed_at_rest():
    result = settled(still(), observations=7 + 7 + 3 + 6)
    check_contract(result.contract, SPEC, "x.toml")
    assert np.flatnonzero(result.columns == ABSENT).tolist() == [2, 9]
    assert result.contract.observation_size == 21
    ours = [NAMES.index(name) for name in THEIRS]
    assert result.columns[[0, 1, 3, 4, 5, 6]].tolist() == ours
    assert result.columns[17:].tolist() == [15 + k for k in ours[::-1]]
    assert [THEIRS[::-1][k] for k in result.joints] == list(NAMES)
    assert result.contract.observation[0].offset == tuple(POSE[THEIRS.index(name)] for name in NAMES)
    assert result.contract.action.offset == tuple(POSE[THEIRS[::-1].index(name)] for name in NAMES)


def changed_term(place, **changes):
    terms = [dict(each) for each in still()["observation"]]
    terms[place] |= changes
    return still(observation=tuple(terms))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (still(action_joints=None), "joint_names: arm6 has no joint 'finger', expected one of"),
        (
            still(action_joints=("finger", *THEIRS)),
            "action_joints: arm6 has no joint 'finger', expected one of",
        ),
        (still(action_joints=THEIRS[:5]), f"action_joints: found '{THEIRS[5]}' 0 times, expected once"),
        (
            still(joint_names=(*THEIRS[:5], "finger")),
            f"joint_names: found '{THEIRS[5]}' 0 times, expected once",
        ),
        (
            changed_term(0, offset="none"),
            "observation 'q': joint_position: cannot be known of 'finger', not",
        ),
        (
            changed_term(1, offset=1.0),
            "observation 'qd': joint_velocity: cannot be known of 'finger', not",
        ),
        (changed_term(1, clip=(0.5, 1.0)), "observation 'qd': joint_velocity: cannot be known of 'finger'"),
        (
            changed_term(1, source="target_offset"),
            "observation 'qd': target_offset: cannot be known of 'finger'",
        ),
    ],
)
def test_unobservable_joint_is_refused(data, message):
    with pytest.raises(ContractError) as caught:
        settled(data, observations=23)
    assert str(caught.value).startswith(f"x.toml: {message}")


def test_a_draft_of_another_policy_is_refused():
    with pytest.raises(
        ContractError, match=r"found 21 numbers \(q 6 \+ qd 6 \+ goal 3 \+ last 6\), the policy takes 48"
    ):
        settled(drafted(), observations=48)
    with pytest.raises(ContractError, match="joint_names: found 6, the policy gives 7 actions"):
        settled(drafted(), actions=7)


@pytest.mark.parametrize(
    ("frames", "layout"), list(product(("oldest_first", "newest_first"), ("by_term", "by_time")))
)
def test_numbers_of_one_joint_stay_together(frames, layout):
    """Two numbers for each joint, in the owner's order of joints: each finds its own place in the contract."""
    once = {"clip": "none", "history": 2}
    pairs = tuple(float(k) for k in range(12))
    terms = (
        {"name": "angle", "source": "joint_sin_cos", "offset": pairs, "multiply": 1.0, **once},
        {"name": "goal", "source": "goal_position", "offset": "none", "multiply": 1.0, **once},
    )
    how = {"observation": terms, "frames": frames, "layout": layout, "fill": "first"}
    built = settled(drafted(**how), observations=2 * (12 + 3))
    term = built.contract.observation[0]
    place = {name: THEIRS.index(name) for name in NAMES}
    assert term.size == 12
    assert term.offset == tuple(float(2 * place[name] + k) for name in NAMES for k in range(2))
    assert sorted(built.columns) == list(range(30))
    newest = built.columns[:12] if frames == "newest_first" else built.columns[-15:-3]
    if layout == "by_term":
        newest = built.columns[:12] if frames == "newest_first" else built.columns[12:24]
    ours = [2 * NAMES.index(name) + k for name in THEIRS for k in range(2)]
    np.testing.assert_array_equal(newest, 12 + np.array(ours))


def test_a_gait_of_several_legs_is_imported():
    gait = {
        "name": "gait",
        "source": "gait_phase",
        "offset": "none",
        "multiply": 1.0,
        "clip": "none",
        "history": 1,
    }
    legs = gait | {"period_s": 0.5, "phase_offsets": (0.0, 0.5), "layout": "by_leg"}
    built = settled(drafted(observation=(legs,), task="velocity"), observations=4)
    assert (built.contract.observation[0].size, built.contract.phase_offsets) == (4, (0.0, 0.5))
    assert built.contract.gait_layout == "by_leg"
