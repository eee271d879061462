"""Quaternion order and sign of gravity, by how a policy answers to a robot that leans: for robots that can fall."""

from collections.abc import Callable, Iterator

import numpy as np

from deploy.estimation import rotations
from deploy.policy.observation import Observation
from deploy.policy.observation_source import SOURCES
from deploy.policy.observation_terms import Term
from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, failed, passed, warned
from robots.arrays import Floats

LEAN_RAD = 0.2
LEANS = ("upright", "forwards", "backwards", "right", "left")
TURNS = LEAN_RAD * np.array([(0, 0, 0), (0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0)], dtype=float)
"""rad, rotation vectors: x points forwards, y to the left, z up."""
DOWN = np.array([0.0, 0.0, -1.0])
DEAF = 0.01
"""Of a raw action: a policy that balances changes it by more where it leans by `LEAN_RAD`."""
CALMER = 0.75
"""Times the actions of the usual convention."""
TOLD: tuple[str, ...] = ("projected_gravity", "base_orientation")

Convention = Callable[[Floats], Floats]


def tilt(case: Case) -> Iterator[Note]:
    """Leans to four sides, in our convention and in the others that are in use."""
    terms = [term for term in case.contract.observation if _tells(term)]
    if not terms:
        yield passed("does not apply: no term says where down is.")
        return
    yield from _by_training(case)
    sizes = {term.source: term.size for term in case.contract.observation}
    if odd := [term for term in case.contract.observation if term.size != sizes[term.source]]:
        yield failed(
            f"{odd[0].name}: {odd[0].source} has {odd[0].size} numbers here and {sizes[odd[0].source]} in another term."
        )
        return
    answer = _answers(case)
    yield from _answers_to_leans(answer - answer[0])
    calm = _size(answer[0])
    for source, name, convention in (
        ("projected_gravity", "gravity with the other sign, +1 upright", np.negative),
        ("base_orientation", "the quaternion as x, y, z, w", lambda q: np.roll(q, -1, axis=1)),
    ):
        if any(term.source == source for term in terms):
            other = _size(_answers(case, {source: convention})[0])
            if other < CALMER * calm and not case.works:
                yield warned(
                    f"upright it is calmer with {name} (actions of {other:.2g}, with ours {calm:.2g}): training may"
                    " have had that convention: turn it in the graph, or by the sign of the first weights."
                )
    yield passed(
        f"it answers to leaning each way, and to opposite leans with opposite actions; upright {calm:.2g}."
    )


def _tells(term: Term) -> bool:
    return term.source in TOLD and term.size == SOURCES[term.source].size


def _size(action: Floats) -> float:
    return float(np.sqrt((action**2).mean()))


def _answers_to_leans(change: Floats) -> Iterator[Note]:
    """Of (5, A) actions, less those upright, in the order of `LEANS`."""
    for one, other in ((1, 2), (3, 4)):
        sides = f"{LEANS[one]} and {LEANS[other]}"
        heard = float(np.abs(change[[one, other]]).max())
        if heard < DEAF:
            yield warned(
                f"leaning {sides} by {LEAN_RAD} rad changes actions by {heard:.1g} at most: it does not hear where down"
                " is: compare the scale of the term, and its frame."
            )
        elif _size(change[one] + change[other]) > _size(change[one] - change[other]):
            yield warned(
                f"leaning {sides} is answered alike instead of by opposites: sign, order or frame of the term may be"
                " another than training's."
            )


def _by_training(case: Case) -> Iterator[Note]:
    """A robot at work is upright in the mean: which number of the term says so?"""
    start = 0
    for term in case.contract.observation:
        end = start + term.size * term.history
        if case.training is not None and _tells(term):
            mean = case.training.mean[end - term.size : end] * np.array(term.scale)
            yield from _conventions(term, mean + np.array(term.offset or 0.0))
        start = end


def _conventions(term: Term, mean: Floats) -> Iterator[Note]:
    if term.source == "projected_gravity" and mean[2] > 0.5:
        yield failed(
            f"{term.name}: in training its third number was {mean[2]:.2f} in the mean, ours is -1 upright: the sign is"
            " the other one."
        )
    if term.source == "base_orientation" and abs(mean[3]) > abs(mean[0]):
        yield failed(
            f"{term.name}: in training its fourth number was {mean[3]:.2f} in the mean and its first {mean[0]:.2f}: it"
            " is written x, y, z, w; ours is w, x, y, z."
        )


def _answers(case: Case, conventions: dict[str, Convention] | None = None) -> Floats:
    """(5, A) raw actions after a second of standing, in the order of `LEANS`."""
    sources = _standing(case)
    for source, convention in (conventions or {}).items():
        sources[source] = _constant(convention(sources[source]()))
    observation = Observation(case.contract, sources, len(LEANS))
    case.policy.resize(len(LEANS))
    steps = max([case.contract.policy_hz, *(term.history for term in case.contract.observation)])
    for _ in range(steps):
        action = case.policy.step(observation.step())
    return action.astype(float)


def _standing(case: Case) -> dict[str, Callable[[], Floats]]:
    """Readings (5, size) of a robot that stands still in the pose that its policy calls zero."""
    quat = rotations.exp(TURNS)
    down = rotations.matvec(rotations.matrix(quat).transpose(0, 2, 1), _all(DOWN))
    known = {"base_orientation": quat, "projected_gravity": down, "gait_phase": _all(np.array([0.0, 1.0]))}
    readings: dict[str, Floats] = {}
    for term in case.contract.observation:
        rest = np.array(term.offset) if term.offset else np.zeros(term.size)
        if term.source == "joint_position" and not term.offset and term.size == case.spec.n:
            rest = case.spec.joint_array("q_home")
        fits = term.source in known and term.size == known[term.source].shape[1]
        readings[term.source] = known[term.source] if fits else _all(rest)
    return {source: _constant(value) for source, value in readings.items()}


def _all(reading: Floats) -> Floats:
    return np.tile(reading, (len(LEANS), 1))


def _constant(value: Floats) -> Callable[[], Floats]:
    return value.copy
