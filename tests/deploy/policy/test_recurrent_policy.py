"""Policies that remember: from the file to a soak that goes on."""

import json

import numpy as np
import pytest

from deploy.policy.contract import Contract
from deploy.policy.policy import Policy
from robots.errors import ContractError
from support.arm6 import SPEC
from support.contracts import arm_contract
from support.planar import PLANAR3, failing
from support.policies import N, loaded, saved
from support.recurrent_policies import M, by_numpy, remembering
from support.runtimes import ARM_S, built, every

STEPS = 240


@pytest.mark.parametrize("robots", [1, 3, 64])
def test_sequence_equals_numpy_and_robots_are_independent(tmp_path, robots):
    policy, rng = loaded(tmp_path, remembering()), np.random.default_rng(robots)
    observations = rng.normal(size=(STEPS, robots, N)).astype(np.float32)
    forget = [set(rng.integers(0, STEPS, 5).tolist()) for _ in range(robots)]
    actions = []
    policy.resize(robots)
    for step, observation in enumerate(observations):
        policy.reset(np.array([step in each for each in forget]))
        actions.append(policy.step(observation).copy())
    for robot in range(robots):
        expected = by_numpy(observations[:, robot], forget[robot])
        np.testing.assert_allclose(np.array(actions)[:, robot], expected, rtol=0, atol=1e-5)


def test_saved_memory_continues_bit_for_bit(tmp_path):
    one, other = (loaded(tmp_path, remembering()) for _ in range(2))
    observations = np.random.default_rng(4).normal(size=(50, 5, N)).astype(np.float32)
    other.resize(5)
    for observation in observations[:30]:
        one.step(observation)
    other.restore(one.save())
    for observation in observations[30:]:
        assert one.step(observation).tobytes() == other.step(observation).tobytes()


def test_change_of_batch_width_resets_memory(tmp_path):
    policy = loaded(tmp_path, remembering())
    observation = np.ones((2, N), np.float32)
    first = policy.step(observation).copy()
    assert not np.array_equal(policy.step(observation), first)
    policy.step(np.ones((3, N), np.float32))
    np.testing.assert_array_equal(policy.step(observation), first)


def test_bad_observation_spoils_one_memory_until_reset(tmp_path):
    policy, good = loaded(tmp_path, remembering()), np.ones((3, N), np.float32)
    bad = good.copy()
    bad[1, 4] = np.nan
    policy.step(bad)
    assert np.isfinite(policy.step(good)).all(axis=1).tolist() == [True, False, True]
    policy.reset(np.array([False, True, False]))
    assert np.isfinite(policy.step(good)).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frozen": True}, r"golden pairs: found a deviation of 0\.\d+ at batch 1, expected at most 1e-05"),
        ({"memory": 0}, r"input: found \['observation', 'memory'\], expected one, 'observation' float32"),
        (
            {"memory": M + 1},
            r"input 'memory': found FLOAT \['batch', 7\], expected two, 'observation' float32 \(batch, 30\) and"
            r" 'memory' float32 \(batch, 8\) with a batch of any size",
        ),
    ],
)
def test_mismatched_memory_is_refused(tmp_path, changes, message):
    with pytest.raises(ContractError, match=message):
        loaded(tmp_path, remembering(**changes))


@pytest.mark.parametrize("memory", [-1, 1 << 20, 1.0, "3", True])
def test_a_memory_of_no_size_is_refused(memory):
    data = json.loads(arm_contract().to_json()) | {"memory": memory}
    with pytest.raises(ContractError, match=rf"contract: memory: .*found {memory!r}"):
        Contract.from_json(json.dumps(data), "contract")


def test_memory_resets_at_arming_and_survives_restoring(tmp_path):
    path = saved(remembering(), tmp_path)
    first, second = (built(2, policy=Policy.load(path, SPEC)) for _ in range(2))
    for _ in range(round(ARM_S / SPEC.dt)):
        first.tick()
    assert np.abs(first.policy.memory).max(axis=1).all()
    first.arm(every(first))
    assert not first.policy.memory.any()
    for _ in range(20):
        first.tick()
    assert first.policy.memory.any(axis=1).all()
    robot = first.robot.save()
    second.restore(first.save())
    second.robot.restore(robot)
    for _ in range(40):
        first.tick()
        second.tick()
    assert first.policy.memory.tobytes() == second.policy.memory.tobytes()
    assert first.command.q.tobytes() == second.command.q.tobytes()
    first.reset(np.array([True, False]))
    assert first.policy.memory.any(axis=1).tolist() == [False, True]


def test_step_whose_graph_fails_gives_nan_and_keeps_the_memory(tmp_path):
    policy = Policy.load(failing(tmp_path / "policy.onnx", 3), PLANAR3)
    observation = np.zeros((2, policy.contract.observation_size), np.float32)
    finite = [bool(np.isfinite(policy.step(observation)).all()) for _ in range(5)]
    assert finite == [True] * 3 + [False] * 2
    assert policy.memory.tolist() == [[3.0]] * 2
    assert "indices element out of data bounds" in policy.failure
    policy.reset(np.array([True, False]))
    assert np.isnan(policy.step(observation)).all()
    policy.reset(np.array([True, True]))
    assert (policy.step(observation) == 0.0).all()


def test_policy_that_fails_at_once_is_refused(tmp_path):
    with pytest.raises(ContractError, match=r"cannot be run at batch 1: .*out of data bounds"):
        Policy.load(failing(tmp_path / "policy.onnx", 0), PLANAR3)
