"""Check of joint order and signs: simulate all exchanges of two joints and all reversals of one.

Joint names can be right while the network has another order, which the file does not show. The variants are robots of
one simulation with the same goals and noise.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from deploy.policy.contract import Contract
from deploy.policy.policy import Policy
from deploy.policy.policy_file import PolicyFile
from deploy.tasks.task import find_task
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, passed, warned
from policies.doctor.simulation.simulated_run import ON_TIME, SECONDS, run_simulation
from robots.arrays import Float32s, Floats, Ints

ROBOTS_PER_VARIANT, SECONDS_PER_VARIANT = 2, 8.2
"""Robots per variant, and simulated time in s: for two goals to reach; velocity commands take longer."""
VARIANTS_MAX = 80
"""Largest number of variants, enough for twelve joints; more take minutes."""
IMPROVEMENT_MIN, GOALS_GOOD = 0.25, 0.75
"""Shares of goals: improvement over the unchanged policy, and total, that a better variant must have."""


class Variant(NamedTuple):
    """Permutation and signs: the policy's joint j is joint `places[j]` of the robot times `signs[j]`."""

    description: str
    places: Ints
    signs: Floats


def joint_variants(names: tuple[str, ...]) -> list[Variant]:
    """Return the identity, all exchanges of two joints, and all reversals of one."""
    order, as_is = np.arange(len(names)), np.ones(len(names))
    found = [Variant("as it is", order, as_is)]
    for a, b in combinations(order, 2):
        places = order.copy()
        places[[a, b]] = b, a
        found.append(Variant(f"{names[a]} and {names[b]} exchanged", places, as_is))
    reversed_ = [np.where(order == j, -1.0, 1.0) for j in order]
    found += [Variant(f"{name} reversed", order, s) for name, s in zip(names, reversed_, strict=True)]
    return found


class PermutedPolicy(Policy):
    """A policy for `ROBOTS_PER_VARIANT` robots per variant, with permuted and reversed joints.

    Scales and offsets belong to joints too, so readings and actions are converted to rad and back.
    """

    def __init__(self, file: PolicyFile, source: str, variants: list[Variant]) -> None:
        permutations = [
            _permutation(file.contract, variant) for variant in variants for _ in range(ROBOTS_PER_VARIANT)
        ]
        self._columns, self._gain, self._bias, self._inverse, self._slope, self._shift = (
            np.array(part) for part in zip(*permutations, strict=True)
        )
        super().__init__(file, source)

    def step(self, observation: Float32s) -> Float32s:
        """Return actions (B, A) in the robot's order for observations (B, N)."""
        permuted = np.take_along_axis(observation, self._columns, axis=1) * self._gain + self._bias
        action = super().step(permuted.astype(np.float32))
        restored = np.take_along_axis(action, self._inverse, axis=1) * self._slope + self._shift
        return restored.astype(np.float32)


def _permutation(contract: Contract, variant: Variant) -> tuple[Ints | Floats, ...]:
    """Return columns, gain and bias (N,) of the observation, and places, slope and shift (A,) of the action."""
    (_, places, signs), parts, start = variant, [], 0
    for term in contract.observation:
        scale, offset = np.array(term.scale), np.array(term.offset or np.zeros(term.size))
        joints = term.frame == "joint" and term.size == len(places)
        place, sign = (places, signs) if joints else (np.arange(term.size), np.ones(term.size))
        for _ in range(term.history):
            gain, bias = sign * scale[place] / scale, (sign * offset[place] - offset) / scale
            parts.append((start + place, gain, bias))
            start += term.size
    columns, gain, bias = (np.concatenate(part) for part in zip(*parts, strict=True))
    inverse, scale = np.argsort(places), np.array(contract.action.scale)
    offset = np.array(contract.action.offset or np.zeros(len(places)))
    shift = (signs[inverse] * offset[inverse] - offset) / scale
    return columns, gain, bias, inverse, signs[inverse] * scale[inverse] / scale, shift


def joint_order(context: CheckContext) -> Iterator[Message]:
    """Search an exchange or a reversal that reaches more goals."""
    counts, names = context.run.counts, context.spec.joint_names
    if counts.reached.sum() >= GOALS_GOOD * counts.attempted.sum():
        yield passed("not tried: the policy reaches its goals as it is.")
    elif len(variants := joint_variants(names)) > VARIANTS_MAX:
        yield warned(f"{len(names)} joints have too many orders to try: look at it with deploy-run --view.")
    else:
        yield warned(_best_variant(variants, *_goals_by_variant(context, variants)))


def _best_variant(variants: list[Variant], reached: Ints, attempted: int) -> str:
    """Return a sentence about the variant that reaches the most goals."""
    best = int(np.argmax(reached))
    if reached[best] >= GOALS_GOOD * attempted and reached[best] - reached[0] > IMPROVEMENT_MIN * attempted:
        goals = f"{reached[best]} of {attempted} goals instead of {reached[0]}"
        advice = "change the joint names accordingly, and import or export it again"
        found = f"with {variants[best].description} it reaches {goals}"
        return f"{found}: training had that order or sign: {advice}."
    tried = f"of {len(variants) - 1} exchanges of two joints and reversals of one none helps"
    return f"{tried}: order and signs are not the reason, or not the only one."


def _goals_by_variant(context: CheckContext, variants: list[Variant]) -> tuple[Ints, int]:
    """Return the goals reached by each variant, and the number of goals of each."""
    varied = PermutedPolicy(context.file, str(context.path), variants)
    rows = [k % ROBOTS_PER_VARIANT for k in range(ROBOTS_PER_VARIANT * len(variants))]
    commands = find_task(context.contract.task, "contract: task").success_criterion(context.spec).mean
    seconds = SECONDS if commands else SECONDS_PER_VARIANT
    counts = run_simulation(context.spec, varied, ON_TIME, rows, seconds).counts
    reached = counts.reached.reshape(-1, ROBOTS_PER_VARIANT).sum(axis=1)
    return reached, int(counts.attempted[:ROBOTS_PER_VARIANT].sum())
