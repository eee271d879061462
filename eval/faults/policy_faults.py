"""Fault classes of the policy: actions that are not numbers, that stall, jump or run away."""

import numpy as np

from eval.faults.fault_class import ActionFault, Answer, PolicyFault
from robots.spec import RobotSpec

JUMP = 1e6
"""Action far beyond the contract's clip."""


def _nan(call: ActionFault) -> None:
    call.action[call.channel] = np.nan


def _infinite(call: ActionFault) -> None:
    call.action[call.channel] = np.inf


def _run_away(call: ActionFault) -> None:
    call.action[call.channel] = JUMP


def _stall(call: ActionFault) -> None:
    call.action[:] = call.last


def _jump(call: ActionFault) -> None:
    call.action[:] = JUMP if call.call % 2 else -JUMP


def policy_faults(spec: RobotSpec) -> tuple[PolicyFault, ...]:
    """Return the classes of the policy of a robot."""
    joints = tuple(range(spec.n))
    return (
        PolicyFault(what="nan", channels=joints, meaning="one number of the action is NaN", effect=_nan),
        PolicyFault(
            what="infinite",
            channels=joints,
            meaning="one number of the action is infinite",
            effect=_infinite,
        ),
        PolicyFault(what="stalls", answer=Answer.HELD, meaning="repeats its last action", effect=_stall),
        PolicyFault(
            what="jumps",
            answer=Answer.HELD,
            meaning="outputs ±1e6 for every joint, with the other sign in each call",
            effect=_jump,
        ),
        PolicyFault(
            what="runs away",
            channels=joints,
            answer=Answer.HELD,
            meaning="drives one joint towards its limit",
            effect=_run_away,
        ),
    )
