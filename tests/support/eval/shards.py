import pytest

pytest.importorskip("mujoco")

import numpy as np

from deploy.policy.policy import Policy
from eval.faults.fault_response import FaultResponses
from eval.judge.monitors import MONITORS
from eval.shard.job import WIDTH, ShardJob
from eval.shard.judging import COUNTED, ShardResult
from robots.models.nominal_model import torque_max
from support.arm6 import SPEC, arm_judge


def job(policy, **changes):
    digests = {"robot_digest": SPEC.digest, "policy_digest": Policy.load(policy, SPEC).digest}
    wanted = {"seed": 3, "first": 0, "robots": WIDTH, "ticks": 900, "sample_ticks": 100, **digests, **changes}
    return ShardJob(robot=SPEC.folder, policy=policy, **wanted)


N, M = SPEC.n, len(MONITORS)


def lived(samples, robots, seed=0):
    """A shard's result of numbers that could be anything."""
    rng = np.random.default_rng(seed)
    counted = {name: rng.integers(0, 1 << 40, (samples, robots)) for name in COUNTED}
    worn = rng.normal(size=(samples, 4, robots, N))
    worn[-1, :, 0], winding = np.nan, rng.normal(40, 10, (samples, robots, N))
    return ShardResult(
        counts=arm_judge(torque_max(SPEC), robots).counts(),
        responses=FaultResponses(**{name: np.zeros((robots, 0)) for name in FaultResponses.__slots__}),
        winding_c=winding,
        worn=worn,
        folded_back=rng.uniform(0, 1, (samples, robots, N)),
        events=rng.integers(0, 9, (samples, robots, M)),
        **counted,
    )
