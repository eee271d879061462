"""Parity or nothing: our file against the original, step by step, for one robot and for a shard of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.policy.policy import AGREEMENT, BATCHES, Policy
from policies.importers.reference_policy import Original
from robots.arrays import Bools, Float32s
from robots.errors import ContractError

SINGLES, SEQUENCES, STEPS = 1024, 16, 200
FORGOTTEN = 0.01
"""Chance of a reset before any step of a sequence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What an original does.

    Attributes:
        name: in messages.
        observation: (S, T, N) in our order. forget: (S, T) before which steps all is forgotten.
        action: (S, T, A) in our order, as the original computed them.
    """

    name: str
    observation: Float32s
    forget: Bools
    action: Float32s


def trials(
    original: Original, columns: NDArray[np.int64], joints: NDArray[np.int64], seed: int = 0
) -> list[Trial]:
    """Single observations, each from the beginning, and sequences with resets; as `ends.with_our_ends` orders them."""
    rng, made = np.random.default_rng(seed), []
    for name, shape, chance in (
        ("observation", (SINGLES, 1), 1.0),
        ("sequence", (SEQUENCES, STEPS), FORGOTTEN),
    ):
        theirs = original.scattered(rng, shape)
        ours = original.exchanged(theirs, columns)
        forget = rng.random(shape) < chance
        forget[:, 0] = True
        flat = original.play(theirs.reshape(-1, original.facts.observations), forget.ravel())
        action = flat.reshape(*shape, original.facts.actions)[..., joints]
        made.append(Trial(name=name, observation=ours, forget=forget, action=action))
    return made


def check_parity(policy: Policy, played: list[Trial], source: str) -> float:
    """The worst deviation at batches of one and of a shard, as a part of the largest action, or of 1 if that is less.

    Single precision rounds by parts of what it holds, and a memory carries roundings on.

    Raises:
        ContractError: it is too large, naming the first step and output that differ, and the likely cause.
    """
    return max(_compare(policy, trial, batch, source) for trial in played for batch in BATCHES)


def _compare(policy: Policy, trial: Trial, batch: int, source: str) -> float:
    rows = np.arange(-(-len(trial.forget) // batch) * batch) % len(trial.forget)
    found = np.concatenate([_replayed(policy, trial, chunk) for chunk in rows.reshape(-1, batch)])
    found = found[: len(trial.forget)]
    deviation = np.abs(found - trial.action) / max(1.0, np.abs(trial.action).max())
    if (deviation <= AGREEMENT).all():
        return float(deviation.max())
    row, step, output = np.argwhere(~(deviation <= AGREEMENT))[0]
    raise ContractError(
        f"{source}: parity: {trial.name} {row}, step {step}, action {output}, batch {batch}: found"
        f" {found[row, step, output]:.6g}, expected {trial.action[row, step, output]:.6g} of the original:"
        f" {_cause(found[row, step], trial, row, step)}"
    )


def _replayed(policy: Policy, trial: Trial, rows: NDArray[np.int64]) -> Float32s:
    """(len(rows), T, A): so many robots beside each other."""
    policy.resize(len(rows))
    actions = []
    for step in range(trial.forget.shape[1]):
        policy.reset(trial.forget[rows, step])
        actions.append(policy.step(trial.observation[rows, step]).copy())
    return np.stack(actions, axis=1)


def _cause(found: Float32s, trial: Trial, row: int, step: int) -> str:
    expected = trial.action[row, step]
    if _same(np.sort(found), np.sort(expected)):
        return "the joints stand in another order"
    if _same(found, np.tanh(expected)):
        return "the action is squashed by tanh, the original's is not"
    if _same(np.tanh(found), expected):
        return "the original's action is squashed by tanh"
    if not trial.forget[row, step]:
        return "all before agreed: what it remembers is not handed on"
    return "weights or a normalizer differ"


def _same(found: Float32s, expected: Float32s) -> bool:
    return np.allclose(found, expected, rtol=AGREEMENT, atol=AGREEMENT)
