"""Checks that the robot has what the policy needs: matching rates, sensors, and limits in its files."""

import time
from collections.abc import Callable, Iterator

import numpy as np

from deploy.tasks.task import sources_of
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, format_values, passed, warned
from robots.errors import RobotError
from robots.models.collisions import collision_pairs
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.windings import nominal_windings
from robots.sensors import Kind
from robots.spec import RobotSpec

HZ, SECONDS = ("policy_hz",), ("policy_dt", "control_dt", "step_dt")
"""Names of the rate or period in `Contract.trained`."""
FAST_SENSORS: tuple[Kind, ...] = ("encoder", "gyro", "orientation")
"""Sensors whose readings change at every step."""
TOLERANCE = 0.01
"""Relative difference of rates that counts as rounding."""
STEPS = 100
SHARE = 0.2
"""Share of a control period that the network may take."""


def rates(context: CheckContext) -> Iterator[Message]:
    """Compare all rates, in Hz."""
    contract, control_hz = context.contract, context.spec.rates.control_hz
    hz, trained = contract.policy_hz, dict(_trained(context))
    if contract.control_hz != control_hz:
        found = f"made for control at {contract.control_hz} Hz, {context.spec.name} has {control_hz} Hz"
        yield failed(f"{found}: export it again for this robot, or train at its rate.")
    for name, rate in trained.items():
        if abs(rate - hz) > TOLERANCE * hz:
            found = f"policy_hz is {hz}, training has {name}: {rate:.6g} Hz"
            yield failed(f"{found}: put that into the contract.")
    yield from _timing(context, hz, control_hz)
    if "imported" in contract.trained and not trained:
        yield warned(f"policy_hz {hz} was entered at import; the rate of training is not in the file: ask.")
    yield passed(f"policy {hz} Hz, control {control_hz} Hz{', as in training' if trained else ''}.")


def _timing(context: CheckContext, hz: int, control_hz: int) -> Iterator[Message]:
    for kind, sensor in context.spec.sensors.items():
        if kind in FAST_SENSORS and sensor.rate_hz < hz:
            yield warned(f"{kind} has {sensor.rate_hz} new readings per second, the policy runs at {hz} Hz.")
    if (duration := _inference_s(context)) > SHARE / control_hz:
        found = f"the network takes {1e3 * duration:.2g} ms here, and a tick is {1e3 / control_hz:.3g} ms"
        yield warned(f"{found}: make it smaller, or ticks will be late.")


def _trained(context: CheckContext) -> Iterator[tuple[str, float]]:
    """Yield rates in Hz named in the contract's provenance."""
    for name, text in context.contract.trained.items():
        try:
            number = float(text)
        except ValueError:
            continue
        if name in HZ and np.isfinite(number):
            yield name, number
        elif name in SECONDS and np.isfinite(number) and number > 0:
            yield name, 1.0 / number


def _inference_s(context: CheckContext) -> float:
    """Return the median inference time for one robot, s."""
    observation = np.zeros((1, context.contract.observation_size), np.float32)
    durations = []
    for _ in range(STEPS):
        began = time.perf_counter()
        context.policy.step(observation)
        durations.append(time.perf_counter() - began)
    return float(np.median(durations))


def sources(context: CheckContext) -> Iterator[Message]:
    """List the sensor or estimator of each term."""
    sensors, meanings, known = context.spec.sensors, [], sources_of(context.contract.task)
    for term in context.contract.observation:
        declared, name = known[term.source], f"{term.name} ({term.source})"
        refused = [x for x in context.incompatibilities if x.startswith(f"observation.{term.name}.source")]
        if missing := [kind for kind in declared.sensors if kind not in sensors]:
            found = f"needs {' and '.join(missing)}, {context.spec.name} has {', '.join(sensors)}"
            advice = "add the sensor to robot.toml and to the robot, or train without the term"
            yield failed(f"{name} {found}: {advice}.")
        elif refused:
            yield failed(f"{refused[0]}.")
        elif declared.doubt:
            yield warned(f"{name}: {declared.doubt}.")
        meanings.append(f"{term.name}: {declared.meaning}")
    yield passed("; ".join(meanings) + ".")


def proprioception(context: CheckContext) -> Iterator[Message]:
    """Warn of an actor that leans on sensors of the world around the robot."""
    contract, known = context.contract, sources_of(context.contract.task)
    outside = [term for term in contract.observation if known[term.source].sensing == "exteroceptive"]
    if outside:
        names = ", ".join(f"{term.name} ({term.source})" for term in outside)
        numbers = sum(term.size * term.history for term in outside)
        yield warned(
            f"{numbers} of {contract.observation_size} numbers are exteroceptive: {names}: such sensors are slower,"
            " noisier and sometimes blind. Prefer proprioception for the actor and leave them to the critic; what the"
            " task cannot do without, train with its delay, noise and gaps."
        )
    yield passed("no number comes from a sensor of the world around the robot.")


def protection(context: CheckContext) -> Iterator[Message]:
    """Check torque limits, self-collision shapes and motor heat; all that are missing are named."""
    spec = context.spec
    yield from _defined(spec, _torque, "torque is not limited: give each joint its range")
    if "self_collision" not in spec.capabilities:
        yield warned("self-collisions are not checked: robot.toml has no margins.collision_m.")
    elif pairs := len(collision_pairs(*load_pinocchio(spec))):
        yield passed(f"{pairs} pairs of shapes are checked.")
    else:
        found = "no two shapes that could touch: self-collisions are not detected"
        yield failed(f"{spec.model_path}: {found}: give the links capsules that collide.")
    yield from _defined(spec, _heat, "motor temperatures are not estimated")


def _defined(spec: RobotSpec, describe: Callable[[RobotSpec], str], effect: str) -> Iterator[Message]:
    """Describe a property of the robot's files, or fail with the effect of its absence."""
    try:
        yield passed(describe(spec))
    except RobotError as e:
        yield failed(f"{e}: without it {effect}.")


def _torque(spec: RobotSpec) -> str:
    return f"torque: {format_values(spec.joint_names, torque_max(spec), unit=' N·m')}."


def _heat(spec: RobotSpec) -> str:
    nominal_windings(spec)
    hottest = float(np.max(spec.motor_array("winding_max_c")))
    return f"winding temperatures are estimated up to {hottest:g} °C."
