"""Check of quaternion order and gravity sign by the policy's response to a tilted base."""

from collections.abc import Callable, Iterator

import numpy as np

from deploy.policy.contract_term import Term
from deploy.policy.observation import Observation
from deploy.sources.catalogue import SOURCES
from deploy.sources.floating_base import phase_numbers
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, passed, warned
from robots import rotations
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
    terms = context.contract.observation
    used = {term.source for term in terms if _is_gravity_term(term)}
    if not used:
        yield passed("does not apply: no term depends on the tilt.")
        return
    for term, mean in context.training_means:
        yield from _conventions(term, mean) if _is_gravity_term(term) else ()
    sizes = {term.source: term.size for term in terms}
    if other := next((term for term in terms if term.size != sizes[term.source]), None):
        found = f"{other.source} has {other.size} numbers here and {sizes[other.source]} in another term"
        yield failed(f"{other.name}: {found}.")
        return
    responses = _responses(context)
    calm = _rms(responses[0])
    yield from _directions(responses - responses[0])
    yield from _other_conventions(context, used, calm)
    yield passed(
        f"it responds to each tilt, and to opposite tilts with opposite actions; upright {calm:.2g}."
    )


def _other_conventions(context: CheckContext, used: set[str], calm: float) -> Iterator[Message]:
    """Warn of a policy that fails, and is calmer in another convention than with `calm`, its actions in this one."""
    for source, name, convention in (
        ("projected_gravity", "gravity with the other sign, +1 upright", np.negative),
        ("base_orientation", "the quaternion as x, y, z, w", lambda q: np.roll(q, -1, axis=1)),
    ):
        other = _rms(_responses(context, {source: convention})[0]) if source in used else np.inf
        if other < CALMER_SHARE * calm and not context.works:
            found = f"upright its actions are smaller with {name} ({other:.2g} instead of {calm:.2g})"
            advice = "convert it in the graph, or in the first weights"
            yield warned(f"{found}: training may have had that convention: {advice}.")


def _is_gravity_term(term: Term) -> bool:
    return term.source in GRAVITY_SOURCES and term.size == SOURCES[term.source].size


def _rms(action: Floats) -> float:
    return float(np.sqrt((action**2).mean()))


def _directions(change: Floats) -> Iterator[Message]:
    """Check changes of actions (5, A) relative to upright, in the order of `DIRECTIONS`."""
    for one, other in ((1, 2), (3, 4)):
        sides = f"{DIRECTIONS[one]} and {DIRECTIONS[other]}"
        response = float(np.abs(change[[one, other]]).max())
        if response < RESPONSE_MIN:
            found = f"{sides} by {TILT_RAD} rad changes actions by {response:.1g} at most"
            yield warned(
                f"tilting {found}: it does not respond to tilt: compare scale and frame of the term."
            )
        elif _rms(change[one] + change[other]) > _rms(change[one] - change[other]):
            found = f"tilting {sides} gives similar instead of opposite actions"
            yield warned(f"{found}: sign, order or frame of the term may differ from training.")


def _conventions(term: Term, mean: Floats) -> Iterator[Message]:
    """Check the mean of the term in training: a working robot is upright in the mean."""
    if term.source == "projected_gravity" and mean[2] > 0.5:
        found = f"in training its third number was {mean[2]:.2f} in the mean, expected -1 upright"
        yield failed(f"{term.name}: {found}: the sign is reversed.")
    if term.source == "base_orientation" and abs(mean[3]) > abs(mean[0]):
        found = f"in training its fourth number was {mean[3]:.2f} in the mean and its first {mean[0]:.2f}"
        yield failed(f"{term.name}: {found}: its order is x, y, z, w, expected w, x, y, z.")


def _responses(context: CheckContext, conventions: dict[str, Convention] | None = None) -> Floats:
    """Return raw actions (5, A) after a second of standing, in the order of `DIRECTIONS`."""
    sources = _standing_readings(context)
    for source, convention in (conventions or {}).items():
        sources[source] = convention(sources[source]()).copy
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
    legs = 2.0 * np.pi * np.array([context.contract.phase_offsets])
    phase = _repeat(phase_numbers(legs, context.contract.gait_layout)[0])
    known = {"base_orientation": quat, "projected_gravity": down, "gait_phase": phase}
    readings: dict[str, Floats] = {}
    for term in context.contract.observation:
        rest = np.array(term.offset) if term.offset else np.zeros(term.size)
        if term.source == "joint_position" and not term.offset and term.size == context.spec.n:
            rest = context.spec.joint_array("q_home")
        fits = term.source in known and term.size == known[term.source].shape[1]
        readings[term.source] = known[term.source] if fits else _repeat(rest)
    return {source: value.copy for source, value in readings.items()}


def _repeat(reading: Floats) -> Floats:
    return np.tile(reading, (len(DIRECTIONS), 1))
