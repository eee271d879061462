"""Check that the rates of policy, control, training and sensors match."""

import time
from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, passed, warned
from robots.sensors import Kind

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
    hz = contract.policy_hz
    if contract.control_hz != control_hz:
        yield failed(
            f"made for control at {contract.control_hz} Hz, {context.spec.name} has {control_hz} Hz: export"
            " it again for"
            " this robot, or train at its rate."
        )
    trained = dict(_trained(context))
    for name, rate in trained.items():
        if abs(rate - hz) > TOLERANCE * hz:
            yield failed(
                f"policy_hz is {hz}, training has {name}: {rate:.6g} Hz: put that into the contract."
            )
    for kind, sensor in context.spec.sensors.items():
        if kind in FAST_SENSORS and (each := sensor.rate_hz) < hz:
            yield warned(f"{kind} has {each} new readings per second, the policy runs at {hz} Hz.")
    if (durations := _inference_s(context)) > SHARE / control_hz:
        yield warned(
            f"the network takes {1e3 * durations:.2g} ms here, and a tick is {1e3 / control_hz:.3g} ms:"
            " make it smaller, or"
            " ticks will be late."
        )
    if "imported" in context.contract.trained and not trained:
        yield warned(f"policy_hz {hz} was entered at import; the rate of training is not in the file: ask.")
    yield passed(f"policy {hz} Hz, control {control_hz} Hz{', as in training' if trained else ''}.")


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
