"""Whether policy, control, training and sensors keep the same time."""

import time
from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, failed, passed, warned
from robots.sensors import Kind

HZ, SECONDS = ("policy_hz",), ("policy_dt", "control_dt", "step_dt")
"""What training may have called it, in `Contract.trained`."""
QUICK: tuple[Kind, ...] = ("encoder", "gyro", "orientation")
"""What changes from step to step."""
NEAR = 0.01
"""Of a rate: so much is rounding."""
STEPS = 100
SHARE = 0.2
"""Of a control period, that the network may take: the rest of the tick needs the others."""


def rates(case: Case) -> Iterator[Note]:
    """In Hz."""
    contract, control_hz = case.contract, case.spec.rates.control_hz
    hz = contract.policy_hz
    if contract.control_hz != control_hz:
        yield failed(
            f"made for control at {contract.control_hz} Hz, {case.spec.name} has {control_hz} Hz: export it again for"
            " this robot, or train at its rate."
        )
    trained = dict(_trained(case))
    for name, said in trained.items():
        if abs(said - hz) > NEAR * hz:
            yield failed(
                f"policy_hz is {hz}, training says {name}: {said:.6g} Hz: put training's into the contract."
            )
    for kind, sensor in case.spec.sensors.items():
        if kind in QUICK and (each := sensor.rate_hz) < hz:
            yield warned(f"{kind} says something new {each} times a second, the policy asks {hz} times.")
    if (took := _step_s(case)) > SHARE / control_hz:
        yield warned(
            f"the network takes {1e3 * took:.2g} ms here, and a tick is {1e3 / control_hz:.3g} ms: make it smaller, or"
            " ticks will come late."
        )
    if "imported" in case.contract.trained and not trained:
        yield warned(
            f"policy_hz is {hz} by whoever imported it: training's own rate is not in the file: ask."
        )
    yield passed(f"policy {hz} Hz, control {control_hz} Hz{', as training says' if trained else ''}.")


def _trained(case: Case) -> Iterator[tuple[str, float]]:
    """Rates in Hz that the contract's provenance names."""
    for name, text in case.contract.trained.items():
        try:
            number = float(text)
        except ValueError:
            continue
        if name in HZ and np.isfinite(number):
            yield name, number
        elif name in SECONDS and np.isfinite(number) and number > 0:
            yield name, 1.0 / number


def _step_s(case: Case) -> float:
    """s, the median of some steps for one robot."""
    observation = np.zeros((1, case.contract.observation_size), np.float32)
    took = []
    for _ in range(STEPS):
        began = time.perf_counter()
        case.policy.step(observation)
        took.append(time.perf_counter() - began)
    return float(np.median(took))
