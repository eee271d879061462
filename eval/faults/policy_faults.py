"""Fault classes of the policy: actions that are not numbers, that stall, jump or run away."""

from collections.abc import Callable

import numpy as np

from eval.faults.fault_class import ActionFault, Answer, PolicyFault

JUMP = 1e6
"""Action far beyond the contract's clip."""


def _set(value: float) -> Callable[[ActionFault], None]:
    """Return an effect that sets one number of the action."""

    def effect(call: ActionFault) -> None:
        call.action[call.channel] = value

    return effect


def _stall(call: ActionFault) -> None:
    call.action[:] = call.last


def _jump(call: ActionFault) -> None:
    call.action[:] = JUMP if call.call % 2 else -JUMP


POLICY_FAULTS = (
    PolicyFault(what="nan", per_joint=True, meaning="one number of the action is NaN", effect=_set(np.nan)),
    PolicyFault(
        what="infinite",
        per_joint=True,
        meaning="one number of the action is infinite",
        effect=_set(np.inf),
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
        per_joint=True,
        answer=Answer.HELD,
        meaning="drives one joint towards its limit",
        effect=_set(JUMP),
    ),
)
