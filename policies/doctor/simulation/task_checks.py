"""Checks of the simulated run: goals and stops, chatter, delayed actions, and motor heat after eight hours."""

from collections.abc import Iterator

import numpy as np

from eval.judge.monitors import MONITORS
from policies.doctor.check_context import CheckContext, NotSimulatedError
from policies.doctor.check_result import Message, failed, flag, format_values, passed, warned
from policies.doctor.simulation.heat_extrapolation import winding_temperature
from policies.doctor.simulation.simulated_run import (
    GOALS_SHARE_MIN,
    HALF_PERIOD_LATE,
    JITTERED,
    PERIOD_LATE,
    ROBOTS,
    SECONDS,
    Delay,
    SimulatedRun,
)
from robots.arrays import Floats

GOALS_GOOD = 0.9
"""Share of goals that a good policy reaches."""
CHATTER_HZ, WALKING_CHATTER_HZ, WINDOW_S = 4.0, 12.0, 0.5
"""Frequencies above which motion is chatter, for arms and for walking robots, whose steps have higher harmonics; and
the window of the spectrum, s."""
CHATTER_WARN, CHATTER_FAIL = 0.05, 0.15
"""Chatter as a share of a joint's maximum speed: warning and failure."""
CHATTER_GROWTH = 1.5
"""Largest growth of chatter by delayed actions."""
MEASURE = "measure the robot's delay from sensor to motion, and train with it."
NOT_COMPARABLE = "the simulation failed without delay: the effect of a delay cannot be seen."
SHIFT_S = 8 * 3600.0
TARGET_RANGE_MAX = 1.1
"""Largest target as a share of the working range. The smoother clamps targets; compliant drives need larger ones."""
REASONS_SHOWN = 4
SHOWN_RATIOS = ("tracking", "torque", "velocity", "position_requested")


def simulation(context: CheckContext) -> Iterator[Message]:
    """Check goals, stops and limit ratios, as judged in a soak."""
    try:
        counts = context.run.counts
    except NotSimulatedError as e:
        yield failed(f"not tried: {e}.")
        return
    reached, attempted = int(counts.reached.sum()), int(counts.attempted.sum())
    goals = f"{ROBOTS} robots reached {reached} of {attempted} goals in {SECONDS:.0f} s"
    if attempted and reached < GOALS_SHARE_MIN * attempted:
        reason = "or the joint signs and order in the network are not the robot's"
        yield failed(f"{goals}: something in the other rows differs from training, {reason}.")
    elif attempted and reached < GOALS_GOOD * attempted:
        yield warned(f"{goals}.")
    yield from _stops(context.run)
    worst = {name: float(counts.worst[:, counts.columns(name)].max()) for name in SHOWN_RATIOS}
    if worst["position_requested"] > TARGET_RANGE_MAX and context.contract.action.gains is None:
        found = f"asked for {worst['position_requested']:.2f} of the working range, which is clamped"
        yield warned(f"{found}: compare scale and offset, or penalize it in training.")
    ratios = ", ".join(f"{name} {ratio:.2f}" for name, ratio in worst.items())
    yield passed(f"{goals} without a stop; worst limit ratios: {ratios}.")


def _stops(run: SimulatedRun) -> Iterator[Message]:
    """Check stops and limits; the most frequent reasons are named."""
    counts = run.counts
    reasons = ", ".join(f"{why} ({count})" for why, count in run.stops.most_common(REASONS_SHOWN))
    if latches := int(counts.latches.sum()):
        yield failed(f"stopped by power loss {latches} times: {reasons}.")
    elif stops := int(counts.stops.sum()):
        yield warned(f"stopped {stops} times: {reasons}.")
    if hard := [f"{m.name} ({counts.total(m.name)})" for m in MONITORS if m.hard and counts.total(m.name)]:
        yield failed(f"limits violated: {', '.join(hard)}: see the monitors in a soak report.")


def chatter(context: CheckContext) -> Iterator[Message]:
    """Check the share of joint speeds above the chatter frequency."""
    names, run = context.spec.joint_names, context.run
    level = _chatter_level(context, run)
    worst = f"{format_values(names, 100 * level, unit=' %')} of its speed above {_chatter_hz(context):g} Hz"
    advice = "check delay, rates and the penalty on action changes in training"
    if (level > CHATTER_FAIL).any():
        yield failed(f"it chatters strongly: {worst}: {advice}.")
    elif (level > CHATTER_WARN).any():
        yield warned(f"it chatters: {worst}: {advice}.")
    else:
        yield _passed_if_working(run, f"it moves smoothly: {worst}.")


def _chatter_level(context: CheckContext, run: SimulatedRun) -> Floats:
    """Return (n,) root mean square of speeds above `_chatter_hz`, relative to the joint's maximum speed.

    The median window is used: windows in which a motion starts or ends have high frequencies too.
    """
    window = round(WINDOW_S / context.spec.dt)
    whole = len(run.speeds) // window * window
    speeds = run.speeds[:whole].reshape(-1, window, *run.speeds.shape[1:])
    spectrum = np.abs(np.fft.rfft(speeds, axis=1)) ** 2
    fast = np.fft.rfftfreq(window, context.spec.dt) >= _chatter_hz(context)
    power = 2.0 * spectrum[:, fast].sum(axis=1) / window**2
    return np.asarray(np.sqrt(np.median(power, axis=(0, 1))) / context.spec.joint_array("qd_max"))


def _chatter_hz(context: CheckContext) -> float:
    return WALKING_CHATTER_HZ if "floating_base" in context.spec.capabilities else CHATTER_HZ


def _passed_if_working(run: SimulatedRun, ratios: str) -> Message:
    """Return a passed message, or a warning if the robot did not work."""
    return passed(ratios) if run.works else warned(f"{ratios} But the simulation failed: this means little.")


def delay(context: CheckContext) -> Iterator[Message]:
    """Compare with a run whose actions are delayed without compensation."""
    period_ms = 1e3 / context.contract.policy_hz
    half_ms = 1e3 * context.spec.dt * (context.contract.control_hz // context.contract.policy_hz // 2)
    if not context.run.works:
        yield warned(NOT_COMPARABLE)
    elif (effects := _degradation(context, PERIOD_LATE)) is None:
        yield passed(f"actions delayed by a policy period, {period_ms:g} ms, do no harm.")
    elif (half := _degradation(context, HALF_PERIOD_LATE)) is None:
        yield warned(f"with actions {period_ms:g} ms late {effects}; {half_ms:g} ms do no harm: {MEASURE}")
    else:
        yield failed(f"with actions only {half_ms:g} ms late {half}: {MEASURE}")


def jitter(context: CheckContext) -> Iterator[Message]:
    """Compare with a run whose actions have random delays up to a policy period."""
    period_ms = 1e3 / context.contract.policy_hz
    if not context.run.works:
        yield warned(NOT_COMPARABLE)
    elif effects := _degradation(context, JITTERED):
        found = f"with random delays of actions up to {period_ms:g} ms {effects}"
        yield warned(f"{found}: run it on a computer with reliable timing, and train with jitter.")
    else:
        yield passed(f"random delays of actions up to {period_ms:g} ms do no harm.")


def _degradation(context: CheckContext, delay: Delay) -> str | None:
    """Describe what got worse than in the run without delay; None if nothing did."""
    run, other = context.run, context.delayed_run(delay)
    before, after = (int(each.counts.reached.sum()) for each in (run, other))
    effects = [f"it reaches {after} goals instead of {before}"] if after < GOALS_GOOD * before else []
    level, other_level = _chatter_level(context, run), _chatter_level(context, other)
    if (chattering := (other_level > CHATTER_GROWTH * level) & (other_level > CHATTER_WARN)).any():
        names = context.spec.joint_names
        levels = format_values(names, 100 * other_level, unit=" %", selection=chattering)
        effects.append(f"it chatters: {levels} of its speed")
    if (stops := int(other.counts.stops.sum())) > int(run.counts.stops.sum()) + ROBOTS:
        effects.append(f"it stops {stops} times")
    return " and ".join(effects) or None


def heat(context: CheckContext) -> Iterator[Message]:
    """Extrapolate winding temperatures to eight hours with the two-node model."""
    spec, names, heat_load = context.spec, context.spec.joint_names, context.run.heat_load
    hot = winding_temperature(spec, heat_load, SHIFT_S)
    soft, hard = spec.motor_array("winding_soft_c"), spec.motor_array("winding_max_c")
    room = f"after eight hours of this work, with middle values of draws.toml, at {heat_load.ambient:.0f} °C"
    overheated, warm = hot > hard, (hot > soft) & (hot <= hard)
    if overheated.any():
        after = f": too hot: {_overheating_time(context)}"
        yield from flag(failed, overheated, f"{room}: ", names, hot, hard, unit=" °C", after=after)
    yield from flag(warned, warm, f"{room}: ", names, hot, soft, unit=" °C", after=", above the soft limit.")
    yield _passed_if_working(context.run, f"{room}: {format_values(names, hot, unit=' °C')}.")


def _overheating_time(context: CheckContext) -> str:
    """Return a sentence with the hour at which the first winding is too hot."""
    hours, hard = np.arange(0.25, SHIFT_S / 3600 + 0.25, 0.25), context.spec.motor_array("winding_max_c")
    heats = (winding_temperature(context.spec, context.run.heat_load, 3600.0 * hour) for hour in hours)
    hour = next(h for h, hot in zip(hours, heats, strict=True) if (hot > hard).any())
    return f"the first is too hot within {hour:g} h."
