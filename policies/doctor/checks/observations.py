"""Checks of observations against training: normalizer, scale, influence on actions, statistics, history."""

from collections.abc import Iterator

import numpy as np

from deploy.policy.contract import Observed
from deploy.policy.inference import BATCHES
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, flag, format_values, passed, warned
from policies.doctor.checks.normalizer import Statistics
from robots.arrays import Bools, Float32s, Floats, Ints

RMS_RANGE = (0.05, 5.0)
"""Plausible root mean square of a normalized observation number."""
RMS_ZERO = 1e-6
"""Root mean square of a number that is always 0 except for rounding."""
INFLUENCE_MIN = 0.01
"""Change of actions, as a share of their deviation, below which a term has no influence."""
SATURATED = 0.5
"""Largest share of actions at their clip."""
OFFSET_WARN, OFFSET_FAIL = 1.5, 4.0
"""Difference between the means of simulation and training, in deviations of training."""
SPREAD = (0.1, 2.5)
"""Deviation in simulation relative to training. Less is usual: the robot does not explore and is one draw only."""
FRAME_SPREAD_MAX = 1.0
"""Largest difference between frames of a history, in deviations of training."""
SAMPLE = 1024


def normalizer(context: CheckContext) -> Iterator[Message]:
    """Compare the normalizer in the graph with training, and check scale and influence of the observations."""
    observed, found = context.contract.observed, context.normalizer
    yield from _compare_statistics(observed, found)
    names, inputs = _number_names(context), context.run.observation.astype(float)
    if found is not None:
        inputs = (inputs - found.mean) / found.deviation
    rms = np.sqrt((inputs**2).mean(axis=0))
    yield from _scale(rms, names, graph=found is not None)
    if context.training is None:
        unknown = "no normalizer is in the graph, and the file does not tell whether training had one: ask"
        yield warned(f"{unknown}; {_describe_scale(rms, names)}.")
    yield from _saturation(context)
    yield from _influence(context)
    how = "(x − mean)/deviation stands before the first weights" if found else "no normalizer is in the graph"
    yield passed(f"{how}; readings have an order of 1, and every term influences the actions.")


def _compare_statistics(observed: Observed | None, found: Statistics | None) -> Iterator[Message]:
    if observed is None:
        return
    if found is None:
        missing = "the graph has no normalizer before its first weights"
        yield failed(
            f"training normalized its observations, but {missing}: export it again with the normalizer."
        )
        return
    expected = Statistics.of(observed)
    apart = np.abs(expected.mean - found.mean) / expected.deviation
    ratio = found.deviation / expected.deviation
    if (apart > 0.1).any() or (np.abs(np.log(ratio)) > 0.1).any():
        differ = "mean and deviation of the graph differ from those in the contract"
        yield warned(f"{differ}: terms may be scaled both in the contract and in the graph.")


def _scale(rms: Floats, names: list[str], *, graph: bool) -> Iterator[Message]:
    what = "behind the graph's normalizer" if graph else "and no normalizer in the graph"
    before = f"with the contract's scales {what} the network gets "
    advice = "it may get raw readings: compare the scales, and look for the normalizer of training."
    large = _largest_first(rms, rms > RMS_RANGE[1])
    yield from flag(warned, large, before, names, rms, after=f" (root mean square): {advice}")


def _describe_scale(rms: Floats, names: list[str]) -> str:
    """Describe the scale of readings without a normalizer."""
    if not (small := (rms < RMS_RANGE[0]) & (rms > RMS_ZERO)).any():
        return "the contract's scales alone bring its readings to an order of 1"
    numbers = format_values(names, rms, selection=_largest_first(-rms, small))
    return f"with the contract's scales it gets {numbers} (root mean square), which is very small"


def _number_names(context: CheckContext) -> list[str]:
    """(N,) "joint_position elbow", "goal 2"."""
    joints, names = context.spec.joint_names, []
    for term in context.contract.observation:
        of_joints = term.frame == "joint" and term.size == len(joints)
        parts = joints if of_joints else tuple(str(k) for k in range(term.size))
        names += [f"{term.name} {part}" for _ in range(term.history) for part in parts]
    return names


def _saturation(context: CheckContext) -> Iterator[Message]:
    """Check the share of actions at their clip."""
    low, high = context.contract.action.bounds
    action = context.run.action
    share = float(((action <= low) | (action >= high)).mean())
    if share > SATURATED:
        note = warned if context.normalizer else failed
        yield note(
            f"{share:.0%} of all actions are at their clip: readings or weights have another scale than in training,"
            " or the normalizer is missing."
        )


def _influence(context: CheckContext) -> Iterator[Message]:
    """Check whether each term changes the actions; a memory influences them too."""
    changes = _influence_of_terms(context) if not context.contract.memory else ()
    if ignored := [f"{name} ({change:.1%})" for name, change in changes if change < INFLUENCE_MIN]:
        yield warned(
            f"actions hardly change with {', '.join(ignored)} (change relative to their deviation): the scale may be"
            " far too large, or the term is not used."
        )


def _influence_of_terms(context: CheckContext) -> Iterator[tuple[str, float]]:
    """Yield each term with the change of actions if its readings are permuted in time."""
    run, rng = context.run, np.random.default_rng(0)
    rows = run.observation[rng.permutation(len(run.observation))[:SAMPLE]]
    action = _actions(context, rows)
    spread = max(float(action.std(axis=0).mean()), 1e-9)
    for term, part in context.terms:
        other = rows.copy()
        other[:, part] = rows[rng.permutation(len(rows)), part]
        changed = float(np.sqrt(((_actions(context, other) - action) ** 2).mean())) / spread
        if np.ptp(rows[:, part], axis=0).any():  # a constant term cannot change anything
            yield term.name, changed


def _actions(context: CheckContext, rows: Float32s) -> Float32s:
    low, high = context.contract.action.bounds
    return np.clip(context.policy.replay(rows, BATCHES[-1]), low, high)


def training(context: CheckContext) -> Iterator[Message]:
    """Compare observation statistics of training and simulation, number by number."""
    if (expected := context.training) is None:
        missing = "neither contract nor graph has observation statistics of training: nothing to compare"
        yield warned(
            f"{missing}: ask for mean and deviation of the normalizer, or for recorded observations."
        )
        return
    yield from _histories(context, expected)
    found, names = context.run.observation.astype(float), _number_names(context)
    offset = np.abs(found.mean(axis=0) - expected.mean) / expected.deviation
    spread = found.std(axis=0) / expected.deviation
    # A number that is constant in simulation was constant in training too.
    moves = np.abs(found - expected.mean).max(axis=0) > 1e-6
    yield from _offset(offset, names)
    yield from _spread(spread, names, moves & ~_is_command(context))
    vary = f"vary {spread[moves].min(initial=np.inf):.2g} to {spread.max():.2g} times as much"
    means = f"within {offset.max():.1f} deviations of training's"
    yield passed(f"the simulated robot's means are {means}, and {vary}.")


def _offset(offset: Floats, names: list[str]) -> Iterator[Message]:
    before, far = "the mean of the simulated robot is off training's, in deviations: ", offset > OFFSET_FAIL
    after = ": compare scale, offset, unit, frame and order with training."
    yield from flag(failed, _largest_first(offset, far), before, names, offset, after=after)
    noticeable = _largest_first(offset, (offset > OFFSET_WARN) & ~far)
    yield from flag(warned, noticeable, before, names, offset, after=": compare them with training.")


def _spread(spread: Floats, names: list[str], varying: Bools) -> Iterator[Message]:
    before = "readings of the simulated robot vary more than in training, by these factors: "
    wide, after = _largest_first(spread, spread > SPREAD[1]), ": compare scales and units."
    yield from flag(warned, wide, before, names, spread, after=after)
    before, after = (
        "readings hardly vary relative to training: ",
        ": too large a scale, or a sensor without signal.",
    )
    yield from flag(warned, (spread < SPREAD[0]) & varying, before, names, spread, after=after)


def _is_command(context: CheckContext) -> Bools:
    """Return (N,) True for commands, which may be constant by robot.toml."""
    terms = context.contract.observation
    sizes = [term.size * term.history for term in terms]
    return np.repeat([term.source == "velocity_command" for term in terms], sizes)


def _largest_first(numbers: Floats, selection: Bools) -> Ints:
    """Return the selected indices, largest number first."""
    places = np.flatnonzero(selection)
    return places[np.argsort(-numbers[places])]


def _histories(context: CheckContext, expected: Statistics) -> Iterator[Message]:
    """Check that the frames of a history have similar statistics, as in the right layout."""
    for term, part in context.terms:
        shape = (term.history, term.size)
        mean, deviation = expected.mean[part].reshape(shape), expected.deviation[part].reshape(shape)
        if float((np.ptp(mean, axis=0) / deviation.min(axis=0)).max()) > FRAME_SPREAD_MAX:
            yield warned(
                f"{term.name}: the frames of its history differ by more than a deviation of training: another layout"
                " was used: by time or by term, newest or oldest first."
            )
