"""Check of quaternion order and gravity sign by the policy's response to a tilted base."""

from collections.abc import Callable, Iterator

import numpy as np

from deploy.estimation import rotations
from deploy.policy.contract_term import Term
from deploy.policy.observation import Observation
from deploy.policy.observation_sources import SOURCES
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, passed, warned
from robots.arrays import Floats

TILT_RAD = 0.2
DIRECTIONS = ("upright", "forwards", "backwards", "right", "left")
ROTATIONS = TILT_RAD * np.array([(0, 0, 0), (0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0)], dtype=float)
"""rad, rotation vectors: x points forwards, y to the left, z up."""
DOWN = np.array([0.0, 0.0, -1.0])
RESPONSE_MIN = 0.01
"""Smallest change of raw actions of a balancing policy tilted by `TILT_RAD`."""
CALMER_SHARE = 0.75
"""Actions with the other convention relative to this one, below which the other is more plausible."""
GRAVITY_SOURCES: tuple[str, ...] = ("projected_gravity", "base_orientation")

Convention = Callable[[Floats], Floats]


def tilt(context: CheckContext) -> Iterator[Message]:
    """Tilt the base to four sides, in this project's convention and in other common ones."""
    terms = [term for term in context.contract.observation if _is_gravity_term(term)]
    if not terms:
        yield passed("does not apply: no term depends on the tilt.")
        return
    yield from _check_training_mean(context)
    sizes = {term.source: term.size for term in context.contract.observation}
    if mismatched := [term for term in context.contract.observation if term.size != sizes[term.source]]:
        yield failed(
            f"{mismatched[0].name}: {mismatched[0].source} has {mismatched[0].size} numbers here and"
            f" {sizes[mismatched[0].source]} in another term."
        )
        return
    responses = _responses(context)
    yield from _check_responses(responses - responses[0])
    calm = _rms(responses[0])
    for source, name, convention in (
        ("projected_gravity", "gravity with the other sign, +1 upright", np.negative),
        ("base_orientation", "the quaternion as x, y, z, w", lambda q: np.roll(q, -1, axis=1)),
    ):
        if any(term.source == source for term in terms):
            other = _rms(_responses(context, {source: convention})[0])
            if other < CALMER_SHARE * calm and not context.works:
                yield warned(
                    f"upright its actions are smaller with {name} ({other:.2g} instead of {calm:.2g}): training may"
                    " have had that convention: convert it in the graph, or in the first weights."
                )
    yield passed(
        f"it responds to each tilt, and to opposite tilts with opposite actions; upright {calm:.2g}."
    )


def _is_gravity_term(term: Term) -> bool:
    return term.source in GRAVITY_SOURCES and term.size == SOURCES[term.source].size


def _rms(action: Floats) -> float:
    return float(np.sqrt((action**2).mean()))


def _check_responses(change: Floats) -> Iterator[Message]:
    """Check changes of actions (5, A) relative to upright, in the order of `DIRECTIONS`."""
    for one, other in ((1, 2), (3, 4)):
        sides = f"{DIRECTIONS[one]} and {DIRECTIONS[other]}"
        response = float(np.abs(change[[one, other]]).max())
        if response < RESPONSE_MIN:
            yield warned(
                f"tilting {sides} by {TILT_RAD} rad changes actions by {response:.1g} at most: it does not respond"
                " to tilt: compare scale and frame of the term."
            )
        elif _rms(change[one] + change[other]) > _rms(change[one] - change[other]):
            yield warned(
                f"tilting {sides} gives similar instead of opposite actions: sign, order or frame of the term may"
                " differ from training."
            )


def _check_training_mean(context: CheckContext) -> Iterator[Message]:
    """Check the mean of the term in training: a working robot is upright in the mean."""
    start = 0
    for term in context.contract.observation:
        end = start + term.size * term.history
        if context.training is not None and _is_gravity_term(term):
            mean = context.training.mean[end - term.size : end] * np.array(term.scale)
            yield from _conventions(term, mean + np.array(term.offset or 0.0))
        start = end


def _conventions(term: Term, mean: Floats) -> Iterator[Message]:
    if term.source == "projected_gravity" and mean[2] > 0.5:
        yield failed(
            f"{term.name}: in training its third number was {mean[2]:.2f} in the mean, expected -1 upright: the sign is"
            " reversed."
        )
    if term.source == "base_orientation" and abs(mean[3]) > abs(mean[0]):
        yield failed(
            f"{term.name}: in training its fourth number was {mean[3]:.2f} in the mean and its first {mean[0]:.2f}: its"
            " order is x, y, z, w, expected w, x, y, z."
        )


def _responses(context: CheckContext, conventions: dict[str, Convention] | None = None) -> Floats:
    """Return raw actions (5, A) after a second of standing, in the order of `DIRECTIONS`."""
    sources = _standing_readings(context)
    for source, convention in (conventions or {}).items():
        sources[source] = _constant(convention(sources[source]()))
    observation = Observation(context.contract, sources, len(DIRECTIONS))
    context.policy.resize(len(DIRECTIONS))
    steps = max([context.contract.policy_hz, *(term.history for term in context.contract.observation)])
    for _ in range(steps):
        action = context.policy.step(observation.step())
    return action.astype(float)


def _standing_readings(context: CheckContext) -> dict[str, Callable[[], Floats]]:
    """Return readings (5, size) of a robot standing still in the default pose of its policy."""
    quat = rotations.exp(ROTATIONS)
    down = rotations.matvec(rotations.matrix(quat).transpose(0, 2, 1), _repeat(DOWN))
    known = {"base_orientation": quat, "projected_gravity": down, "gait_phase": _repeat(np.array([0.0, 1.0]))}
    readings: dict[str, Floats] = {}
    for term in context.contract.observation:
        rest = np.array(term.offset) if term.offset else np.zeros(term.size)
        if term.source == "joint_position" and not term.offset and term.size == context.spec.n:
            rest = context.spec.joint_array("q_home")
        fits = term.source in known and term.size == known[term.source].shape[1]
        readings[term.source] = known[term.source] if fits else _repeat(rest)
    return {source: _constant(value) for source, value in readings.items()}


def _repeat(reading: Floats) -> Floats:
    return np.tile(reading, (len(DIRECTIONS), 1))


def _constant(value: Floats) -> Callable[[], Floats]:
    return value.copy
