"""What became of a short life in simulation: the work itself, shaking, late actions, and eight hours of such heat."""

from collections.abc import Iterator

import numpy as np

from eval.judge.monitors import MONITORS
from policies.doctor.check_context import Case, UntriedError
from policies.doctor.check_result import Note, failed, listed, passed, warned
from policies.doctor.simulation.heat_extrapolation import windings_after
from policies.doctor.simulation.simulated_run import HALF_OF, ROBOTS, SECONDS, Life
from robots.arrays import Floats

MOSTLY = 0.9
"""Goals of a policy that works well."""
SHAKING_HZ, STEPPING_HZ, WINDOW_S = 4.0, 12.0, 0.5
"""What is faster than this shakes; of a robot that walks, whose steps come two or three times a second and end hard,
what is faster than that."""
SHAKES, RATTLES = 0.05, 0.15
"""Of a joint's speed."""
WORSE = 1.5
"""Times the shaking of a punctual life: what lateness alone may add."""
MEASURE = "measure the robot's delay from sensor to motion, and train with it."
USELESS = "the trial failed with punctual actions: what lateness would add cannot be seen."
SHIFT_S = 8 * 3600.0
ASKED = 1.1
"""Of a joint's working range, which targets may pass a little: the smoother clamps them. Those of soft drives must."""
REASONS_SHOWN = 4
WATCHED = ("tracking", "torque", "velocity", "position_requested")


def trial(case: Case) -> Iterator[Note]:
    """Goals, stops and how near the limits it came, as the judge of soaks saw it."""
    try:
        life, counts = case.life, case.life.counts
    except UntriedError as e:
        yield failed(f"not tried: {e}.")
        return
    reached, attempted = int(counts.reached.sum()), int(counts.attempted.sum())
    goals = f"{reached} of {attempted} goals"
    if attempted and reached < HALF_OF * attempted:
        yield failed(
            f"{ROBOTS} robots reached {goals} in {SECONDS:.0f} s: something of the other rows is not as in training,"
            " or the signs and order inside the network are not the robot's."
        )
    elif attempted and reached < MOSTLY * attempted:
        yield warned(f"{ROBOTS} robots reached {goals} in {SECONDS:.0f} s.")
    if latches := int(counts.latches.sum()):
        yield failed(f"lost power {latches} times: {_reasons(life)}.")
    elif stops := int(counts.stops.sum()):
        yield warned(f"stopped {stops} times: {_reasons(life)}.")
    if hard := [f"{m.name} ({counts.total(m.name)})" for m in MONITORS if m.hard and counts.total(m.name)]:
        yield failed(
            f"the judge saw what must not happen: {', '.join(hard)}: see the monitors in a soak's report."
        )
    loads = {name: float(counts.worst[:, counts.columns(name)].max()) for name in WATCHED}
    if loads["position_requested"] > ASKED and case.contract.action.gains is None:
        yield warned(
            f"asked for {loads['position_requested']:.2f} of the working range, which nothing obeys: compare scale and"
            " offset, or let training pay for it."
        )
    said = ", ".join(f"{name} {load:.2f}" for name, load in loads.items())
    yield passed(f"{ROBOTS} robots reached {goals} in {SECONDS:.0f} s without a stop; worst loads: {said}.")


def _reasons(life: Life) -> str:
    return ", ".join(f"{why} ({many})" for why, many in life.stops.most_common(REASONS_SHOWN))


def chatter(case: Case) -> Iterator[Note]:
    """How much of the speeds is shaking."""
    names, life = case.spec.joint_names, case.life
    shaking = _shaking(case, life)
    worst = f"{listed(names, 100 * shaking, unit=' %')} of its speed above {_shaking_hz(case):g} Hz"
    if (shaking > RATTLES).any():
        yield failed(
            f"it rattles: {worst}: look at delay, rates and the price of changing actions in training."
        )
    elif (shaking > SHAKES).any():
        yield warned(
            f"it shakes: {worst}: look at delay, rates and the price of changing actions in training."
        )
    else:
        yield _of(life, f"it moves smoothly: {worst}.")


def _shaking(case: Case, life: Life) -> Floats:
    """(n,) root mean square of the speeds above `_shaking_hz`, as a share of the joint's speed.

    Of the median window: one that begins or ends a motion has such speeds too.
    """
    window = round(WINDOW_S / case.spec.dt)
    whole = len(life.speeds) // window * window
    speeds = life.speeds[:whole].reshape(-1, window, *life.speeds.shape[1:])
    spectrum = np.abs(np.fft.rfft(speeds, axis=1)) ** 2
    fast = np.fft.rfftfreq(window, case.spec.dt) >= _shaking_hz(case)
    power = 2.0 * spectrum[:, fast].sum(axis=1) / window**2
    return np.asarray(np.sqrt(np.median(power, axis=(0, 1))) / case.spec.joint_array("qd_max"))


def _shaking_hz(case: Case) -> float:
    return STEPPING_HZ if case.spec.base else SHAKING_HZ


def _of(life: Life, said: str) -> Note:
    """What would pass if the robot had worked."""
    return passed(said) if life.works else warned(f"{said} But the trial failed: this says little.")


def delay(case: Case) -> Iterator[Note]:
    """The same life with actions that come late by a time that nobody told the estimator."""
    period_ms = 1e3 / case.contract.policy_hz
    half_ms = 1e3 * case.spec.dt * (case.contract.control_hz // case.contract.policy_hz // 2)
    if not case.life.works:
        yield warned(USELESS)
    elif (worse := _worse(case, case.late)) is None:
        yield passed(f"actions that come a policy period, {period_ms:g} ms, late do no harm.")
    elif (half := _worse(case, case.half_late)) is None:
        yield warned(f"with actions {period_ms:g} ms late {worse}; {half_ms:g} ms do no harm: {MEASURE}")
    else:
        yield failed(f"with actions only {half_ms:g} ms late {half}: {MEASURE}")


def jitter(case: Case) -> Iterator[Note]:
    """The same life with actions that come late by any time up to a policy period."""
    period_ms = 1e3 / case.contract.policy_hz
    if not case.life.works:
        yield warned(USELESS)
    elif worse := _worse(case, case.jittered):
        yield warned(
            f"with actions up to {period_ms:g} ms late, each by another time, {worse}: run it on a computer that keeps"
            " its time, and train with jitter."
        )
    else:
        yield passed(f"actions up to {period_ms:g} ms late, each by another time, do no harm.")


def _worse(case: Case, other: Life) -> str | None:
    """What another life did worse than the one as it should be; None: nothing."""
    life = case.life
    before, after = (int(each.counts.reached.sum()) for each in (life, other))
    told = []
    if after < MOSTLY * before:
        told.append(f"it reaches {after} goals instead of {before}")
    shaking, more = _shaking(case, life), _shaking(case, other)
    if (shakes := (more > WORSE * shaking) & (more > SHAKES)).any():
        told.append(
            f"it shakes: {listed(case.spec.joint_names, 100 * more, unit=' %', which=shakes)} of its speed"
        )
    if (stops := int(other.counts.stops.sum())) > int(life.counts.stops.sum()) + ROBOTS:
        told.append(f"it stops {stops} times")
    return " and ".join(told) or None


def heat(case: Case) -> Iterator[Note]:
    """Eight hours of the same work, by the two-node model of the motors."""
    spec, warmth = case.spec, case.life.warmth
    names = spec.joint_names
    hot = windings_after(spec, warmth, SHIFT_S)
    soft, hard = spec.motor_array("winding_soft_c"), spec.motor_array("winding_max_c")
    room = f"after eight hours of this, in the middle of draws.toml, at {warmth.ambient:.0f} °C"
    if (burnt := hot > hard).any():
        yield failed(
            f"{room}: {listed(names, hot, hard, unit=' °C', which=burnt)}: it will not last: {_when(case)}"
        )
    if (warm := (hot > soft) & ~burnt).any():
        yield warned(f"{room}: {listed(names, hot, soft, unit=' °C', which=warm)}, beyond the soft limit.")
    yield _of(case.life, f"{room}: {listed(names, hot, unit=' °C')}.")


def _when(case: Case) -> str:
    """Of a shift in which one becomes too hot."""
    hours, hard = np.arange(0.25, SHIFT_S / 3600 + 0.25, 0.25), case.spec.motor_array("winding_max_c")
    heats = (windings_after(case.spec, case.life.warmth, 3600.0 * hour) for hour in hours)
    hour = next(h for h, hot in zip(hours, heats, strict=True) if (hot > hard).any())
    return f"the first is there within {hour:g} h."
