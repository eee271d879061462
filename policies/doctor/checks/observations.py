"""Whether the network hears what it heard in training: by its graph, by its behaviour, by numbers of training."""

from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, failed, listed, passed, warned
from policies.doctor.checks.normalizer import Statistics
from robots.arrays import Bools, Float32s, Floats, Ints

ORDER = (0.05, 5.0)
"""Root mean square of a number as the network gets it, if it was brought to an order of 1."""
SILENT = 1e-6
"""What is always 0 but for rounding needs no normalizer."""
IGNORED = 0.01
"""Of the actions' own spread, by which they change at least where a term that is heard says something else."""
SATURATED = 0.5
"""Of all actions at their clip: more leaves nothing to steer with."""
OFF, FAR_OFF = 1.5, 4.0
"""Deviations of training between its mean and the one of the simulated robot."""
SPREAD = (0.1, 2.5)
"""Times the deviation of training. The robot explores nothing and is one draw of many: less is usual, much more not."""
ALIKE = 1.0
"""Deviations that frames of one term's history may lie apart."""
SAMPLE = 1024


def normalizer(case: Case) -> Iterator[Note]:
    """Is one in the graph, did training have one, and what do the actions say?"""
    observed, found = case.contract.observed, case.normalizer
    if observed is not None and found is None:
        yield failed(
            "training normalized its observations, and nothing stands before the first weights of the graph that does:"
            " export it again with the normalizer."
        )
    if observed is not None and found is not None:
        yield from _the_same(Statistics.of(observed), found)
    life, names = case.life, _number_names(case)
    heard = life.observation.astype(float)
    if found is not None:
        heard = (heard - found.mean) / found.deviation
    rms = np.sqrt((heard**2).mean(axis=0))
    yield from _order(rms, names, graph=found is not None)
    if case.training is None:
        yield warned(
            "no normalizer is in the graph, and whether training had one cannot be seen: ask; "
            f"{_unknown(rms, names)}."
        )
    yield from _steering(case)
    how = "(x − mean)/deviation stands before the first weights" if found else "no normalizer is in the graph"
    yield passed(f"{how}; ordinary readings come to an order of 1, and every term is heard.")


def _the_same(told: Statistics, found: Statistics) -> Iterator[Note]:
    apart = np.abs(told.mean - found.mean) / told.deviation
    ratio = found.deviation / told.deviation
    if (apart > 0.1).any() or (np.abs(np.log(ratio)) > 0.1).any():
        yield warned(
            "the graph's mean and deviation are not those that the contract says of training: its terms may be scaled"
            " once in the contract and once more in the graph."
        )


def _order(rms: Floats, names: list[str], *, graph: bool) -> Iterator[Note]:
    what = "behind the graph's normalizer" if graph else "and no normalizer in the graph"
    if (loud := rms > ORDER[1]).any():
        yield warned(
            f"with the contract's scales {what} the network gets"
            f" {listed(names, rms, which=_most(rms, loud))} (root mean square): it may be"
            " fed raw readings: compare the scales, and look for the normalizer of training."
        )


def _unknown(rms: Floats, names: list[str]) -> str:
    """Of a network without a normalizer, of which nobody says whether it had one."""
    if not (faint := (rms < ORDER[0]) & (rms > SILENT)).any():
        return "the contract's scales alone bring its readings to an order of 1"
    return (
        f"by the contract's scales it gets {listed(names, rms, which=_most(-rms, faint))} (root mean square), which it"
        " hardly hears"
    )


def _number_names(case: Case) -> list[str]:
    """(N,) "joint_position elbow", "goal 2"."""
    joints, names = case.spec.joint_names, []
    for term in case.contract.observation:
        parts = joints if term.size == len(joints) else tuple(str(k) for k in range(term.size))
        names += [f"{term.name} {part}" for _ in range(term.history) for part in parts]
    return names


def _steering(case: Case) -> Iterator[Note]:
    """Whether actions are all at their ends, and whether each term changes them."""
    low, high = case.contract.action.bounds
    action = case.life.action
    share = float(((action <= low) | (action >= high)).mean())
    if share > SATURATED:
        note = warned if case.normalizer else failed
        yield note(
            f"{share:.0%} of all actions are at their clip in ordinary work: readings or weights are not of training's"
            " scale, or its normalizer is lost."
        )
    if case.contract.memory:
        return  # what it remembers answers as well
    if deaf := [f"{name} ({heard:.1%})" for name, heard in _heard(case) if heard < IGNORED]:
        yield warned(
            f"actions hardly change with {', '.join(deaf)} (change as a share of their own spread): the scale may be"
            " far too large, or the term is of no use."
        )


def _heard(case: Case) -> Iterator[tuple[str, float]]:
    """Each term with what actions change where it says what it says at other times: readings stay ordinary."""
    life, start = case.life, 0
    rng = np.random.default_rng(0)
    rows = life.observation[rng.permutation(len(life.observation))[:SAMPLE]]
    action = _actions(case, rows)
    spread = max(float(action.std(axis=0).mean()), 1e-9)
    for term in case.contract.observation:
        end = start + term.size * term.history
        other = rows.copy()
        other[:, start:end] = rows[rng.permutation(len(rows)), start:end]
        changed = float(np.sqrt(((_actions(case, other) - action) ** 2).mean())) / spread
        if np.ptp(rows[:, start:end], axis=0).any():  # a term that says one thing can change nothing
            yield term.name, changed
        start = end


def _actions(case: Case, rows: Float32s) -> Float32s:
    low, high = case.contract.action.bounds
    return np.clip(case.policy.replay(rows, len(rows)), low, high)


def training(case: Case) -> Iterator[Note]:
    """What observations were like in training against those of the simulated robot, number by number."""
    if (told := case.training) is None:
        yield warned(
            "neither contract nor graph says what observations were like in training: nothing can be compared: ask for"
            " mean and deviation of its normalizer, or for some recorded observations."
        )
        return
    yield from _history(case, told)
    life, names = case.life, _number_names(case)
    seen = life.observation.astype(float)
    off, spread = np.abs(seen.mean(axis=0) - told.mean) / told.deviation, seen.std(axis=0) / told.deviation
    if (far := off > FAR_OFF).any():
        yield failed(
            "the mean of the simulated robot is off training's, in deviations:"
            f" {listed(names, off, which=_most(off, far))}: compare scale, offset, unit, frame"
            " and order of these with training's."
        )
    if (odd := (off > OFF) & ~far).any():
        yield warned(
            "the mean of the simulated robot is off training's, in deviations:"
            f" {listed(names, off, which=_most(off, odd))}: compare them with training's."
        )
    if (wide := spread > SPREAD[1]).any():
        yield warned(
            "the simulated robot's readings vary more than training's, so many times:"
            f" {listed(names, spread, which=_most(spread, wide))}: compare scales and units."
        )
    moves = np.abs(seen - told.mean).max(axis=0) > 1e-6  # what is always the same was so in training
    still = (spread < SPREAD[0]) & moves & ~_commanded(case)
    if still.any():
        yield warned(
            f"readings hardly vary, as a share of training's: {listed(names, spread, which=still)}: too large a"
            " scale, or a sensor that says nothing."
        )
    yield passed(
        f"the simulated robot's means are within {off.max():.1f} deviations of training's, and vary"
        f" {spread[moves].min(initial=np.inf):.2g} to {spread.max():.2g} times as much."
    )


def _commanded(case: Case) -> Bools:
    """(N,) whether a number is a command, which robot.toml may have stand still."""
    terms = case.contract.observation
    sizes = [term.size * term.history for term in terms]
    return np.repeat([term.source == "velocity_command" for term in terms], sizes)


def _most(numbers: Floats, which: Bools) -> Ints:
    """Places where `which` holds, the largest number first."""
    places = np.flatnonzero(which)
    return places[np.argsort(-numbers[places])]


def _history(case: Case, told: Statistics) -> Iterator[Note]:
    """Frames of a term are of the same reading, a little later each: in the right layout they are alike."""
    start = 0
    for term in case.contract.observation:
        end = start + term.size * term.history
        mean, deviation = (x[start:end].reshape(term.history, term.size) for x in (told.mean, told.deviation))
        if float((np.ptp(mean, axis=0) / deviation.min(axis=0)).max()) > ALIKE:
            yield warned(
                f"{term.name}: frames of its history differ by more than a deviation of training: its layout is"
                " another: by time or by term, newest or oldest first."
            )
        start = end
