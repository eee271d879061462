"""Judge of a shard, and the inputs it gets from the runtime after each tick."""

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Contract
from deploy.runtime import Runtime
from deploy.tasks.task import find_task
from deploy.truth import Truth
from eval.judge.judge import Judge
from eval.shard.job import WIDTH
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

Action = NDArray[np.floating] | None
"""(B, A) action of the policy, None in ticks between two of its steps."""


def judge_tick(judge: Judge, truth: Truth, runtime: Runtime, action: Action) -> None:
    """Pass the tick that has just ended to the judge.

    Args:
        judge: gets the inputs.
        truth: ground truth after the tick. runtime: its state, decisions and command of the tick.
        action: output of the policy; None between two of its steps, or where it is not recorded.
    """
    judge.step(
        truth=truth,
        state=runtime.state,
        observation=runtime.observation.frames,
        target=runtime.target,
        action=action,
        command=runtime.command,
        mode=runtime.supervisor.mode,
        reason=runtime.supervisor.reason,
        achieved=runtime.task.true_achieved(truth),
        goal=runtime.task.goal,
        attempted=runtime.task.attempted,
    )


def judge_of(spec: RobotSpec, contract: Contract, robots: int) -> Judge:
    """Return the judge of a shard before its first tick; the first `robots` of its `WIDTH` robots count."""
    scoring = find_task(contract.task, "contract: task").scoring(spec)
    return Judge(spec, torque_max(spec), WIDTH, scoring=scoring, counted=robots, observed=contract.observed)
