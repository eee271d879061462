"""Whether joints that are exchanged, or that turn the other way, explain a trial that went badly: each is tried.

Names may be right and stand in the wrong order, and then nothing in the file says so. Every variant is a robot of its
own beside the others, with the same goals and noise, so that all of them live at once.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from deploy.policy.contract import Contract
from deploy.policy.policy import Policy
from deploy.policy.policy_file import PolicyFile
from deploy.tasks.task import find_task
from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, passed, warned
from policies.doctor.simulation.simulated_run import PUNCTUAL, SECONDS, live
from robots.arrays import Float32s, Floats, Ints

EACH, SHORT_S = 2, 8.2
"""Robots of each variant, and how long they live, s: for two points each to reach; a speed to walk takes longer."""
VARIANTS_MAX = 80
"""All exchanges of two and all reversals of one of twelve joints, and a few; more take minutes."""
BETTER, WELL = 0.25, 0.75
"""Of its goals, that a variant must reach more of than the policy as it is, and that it must reach."""


class Variant(NamedTuple):
    """Joint `places[j]` of the robot, `signs[j]` times, is what the policy takes for joint j."""

    said: str
    places: Ints
    signs: Floats


def variants(names: tuple[str, ...]) -> list[Variant]:
    """As it is, every two joints exchanged, every one reversed."""
    order, as_is = np.arange(len(names)), np.ones(len(names))
    found = [Variant("as it is", order, as_is)]
    for a, b in combinations(order, 2):
        places = order.copy()
        places[[a, b]] = b, a
        found.append(Variant(f"{names[a]} and {names[b]} exchanged", places, as_is))
    reversed_ = [np.where(order == j, -1.0, 1.0) for j in order]
    found += [
        Variant(f"{name} turned the other way", order, s) for name, s in zip(names, reversed_, strict=True)
    ]
    return found


class Varied(Policy):
    """A policy that stands before as many robots as variants, `EACH` times, each behind its own variant.

    A contract whose names stand in the wrong order gives each joint the other's scale and offset: readings and actions
    are brought to rad and back.
    """

    def __init__(self, file: PolicyFile, source: str, tried: list[Variant]) -> None:
        lines = [_line(file.contract, variant) for variant in tried for _ in range(EACH)]
        self._columns, self._gain, self._bias, self._back, self._slope, self._shift = (
            np.array(part) for part in zip(*lines, strict=True)
        )
        super().__init__(file, source)

    def step(self, observation: Float32s) -> Float32s:
        """(B, N) to (B, A), in the robot's order."""
        theirs = np.take_along_axis(observation, self._columns, axis=1) * self._gain + self._bias
        said = super().step(theirs.astype(np.float32))
        ours = np.take_along_axis(said, self._back, axis=1) * self._slope + self._shift
        return ours.astype(np.float32)


def _line(contract: Contract, variant: Variant) -> tuple[Ints | Floats, ...]:
    """Of one variant: columns, gain and bias (N,) of its observation; places, slope and shift (A,) of its action."""
    places, signs = variant.places, variant.signs
    parts, start = [], 0
    for term in contract.observation:
        scale, offset = np.array(term.scale), np.array(term.offset or np.zeros(term.size))
        joints = term.frame == "joint" and term.size == len(places)
        place, sign = (places, signs) if joints else (np.arange(term.size), np.ones(term.size))
        for _ in range(term.history):
            gain, bias = sign * scale[place] / scale, (sign * offset[place] - offset) / scale
            parts.append((start + place, gain, bias))
            start += term.size
    columns, gain, bias = (np.concatenate(part) for part in zip(*parts, strict=True))
    back = np.argsort(places)
    scale = np.array(contract.action.scale)
    offset = np.array(contract.action.offset or np.zeros(len(places)))
    shift = (signs[back] * offset[back] - offset) / scale
    return columns, gain, bias, back, signs[back] * scale[back] / scale, shift


def orders(case: Case) -> Iterator[Note]:
    """Does another order, or another sign, do what this one does not?"""
    counts, names = case.life.counts, case.spec.joint_names
    if counts.reached.sum() >= WELL * counts.attempted.sum():
        yield passed("not asked: it does its work as it is.")
        return
    tried = variants(names)
    if len(tried) > VARIANTS_MAX:
        yield warned(
            f"{len(names)} joints have too many orders to try them: look at it with deploy-run --view."
        )
        return
    reached, attempted = _reached(case, tried)
    best = int(np.argmax(reached))
    if reached[best] >= WELL * attempted and reached[best] - reached[0] > BETTER * attempted:
        yield warned(
            f"with {tried[best].said} it reaches {reached[best]} of {attempted} goals instead of {reached[0]}: so is"
            " the order, or the axis, of its training: name the joints so, and import or export it again."
        )
        return
    yield warned(
        f"of {len(tried) - 1} exchanges of two joints and reversals of one none helps: it is not that, or not that"
        " alone."
    )


def _reached(case: Case, tried: list[Variant]) -> tuple[Ints, int]:
    """Goals that each variant reached, and how many each had."""
    varied = Varied(case.file, str(case.path), tried)
    rows = [k % EACH for k in range(EACH * len(tried))]
    seconds = SECONDS if find_task(case.contract.task, "contract: task").scoring(case.spec).mean else SHORT_S
    counts = live(case.spec, varied, PUNCTUAL, rows, seconds).counts
    return counts.reached.reshape(-1, EACH).sum(axis=1), int(counts.attempted[:EACH].sum())
