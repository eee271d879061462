"""Comparison of the converted policy with the reference, step by step, at batch 1 and at the shard width."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.policy.inference import BATCHES
from deploy.policy.policy import AGREEMENT, Policy
from policies.importers.reference_policy import ReferencePolicy
from robots.arrays import Bools, Float32s
from robots.errors import ContractError

SINGLES, SEQUENCES, STEPS = 1024, 16, 200
RESET_CHANCE = 0.01
"""Probability of a reset before each step of a sequence."""
KINDS = ("observation", (SINGLES, 1), 1.0), ("sequence", (SEQUENCES, STEPS), RESET_CHANCE)
"""Single observations, each after a reset, and sequences with random resets: name, shape, probability of a reset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceRun:
    """Observations and actions of the reference.

    Attributes:
        name: for error messages.
        observation: (S, T, N) in the contract's order. resets: (S, T) steps before which the memory is reset.
        action: (S, T, A) of the reference, in the contract's order.
    """

    name: str
    observation: Float32s
    resets: Bools
    action: Float32s


def record_reference(
    reference: ReferencePolicy, columns: NDArray[np.int64], joints: NDArray[np.int64], seed: int = 0
) -> list[ReferenceRun]:
    """Run the reference on single observations and on sequences, permuted as in `contract_builder.BuiltContract`."""
    rng, runs = np.random.default_rng(seed), []
    for name, shape, chance in KINDS:
        inputs = reference.sample_observations(rng, shape)
        reordered = reference.reorder_observations(inputs, columns)
        resets = rng.random(shape) < chance
        resets[:, 0] = True
        flat = reference.run(inputs.reshape(-1, inputs.shape[-1]), resets.ravel())
        action = flat.reshape(*shape, -1)[..., joints]
        runs.append(ReferenceRun(name=name, observation=reordered, resets=resets, action=action))
    return runs


def check_parity(policy: Policy, runs: list[ReferenceRun], source: str) -> float:
    """Return the largest deviation at batch 1 and at the shard width, relative to max(1, largest action).

    The deviation is relative because single precision rounds relative to the value, and memories accumulate it.

    Raises:
        ContractError: the deviation is too large; names the first step and output that differ and the likely cause.
    """
    return max(_compare(policy, run, batch, source) for run in runs for batch in BATCHES)


def _compare(policy: Policy, run: ReferenceRun, batch: int, source: str) -> float:
    rows = np.arange(-(-len(run.resets) // batch) * batch) % len(run.resets)
    found = np.concatenate([_run_batch(policy, run, chunk) for chunk in rows.reshape(-1, batch)])
    found = found[: len(run.resets)]
    deviation = np.abs(found - run.action) / max(1.0, np.abs(run.action).max())
    if (deviation <= AGREEMENT).all():
        return float(deviation.max())
    row, step, output = np.argwhere(~(deviation <= AGREEMENT))[0]
    raise ContractError(
        f"{source}: parity: {run.name} {row}, step {step}, action {output}, batch {batch}: found"
        f" {found[row, step, output]:.6g}, expected {run.action[row, step, output]:.6g} of the original:"
        f" {_cause(found[row, step], run, row, step)}"
    )


def _run_batch(policy: Policy, run: ReferenceRun, rows: NDArray[np.int64]) -> Float32s:
    """Return actions (len(rows), T, A) of sequences run side by side as one batch."""
    policy.resize(len(rows))
    actions = []
    for step in range(run.resets.shape[1]):
        policy.reset(run.resets[rows, step])
        actions.append(policy.step(run.observation[rows, step]).copy())
    return np.stack(actions, axis=1)


def _cause(found: Float32s, run: ReferenceRun, row: int, step: int) -> str:
    expected = run.action[row, step]
    if _close(np.sort(found), np.sort(expected)):
        return "the joints are in another order"
    if _close(found, np.tanh(expected)):
        return "the action is squashed by tanh, that of the original is not"
    if _close(np.tanh(found), expected):
        return "the action of the original is squashed by tanh"
    if not run.resets[row, step]:
        return "all earlier steps agree: the memory is not passed on"
    return "weights or a normalizer differ"


def _close(found: Float32s, expected: Float32s) -> bool:
    return np.allclose(found, expected, rtol=AGREEMENT, atol=AGREEMENT)
