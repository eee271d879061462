"""Which joint a reason is about: for the operator, who has to do something about it."""

from collections.abc import Iterator

import numpy as np

from deploy.runtime import Runtime
from deploy.state import Bools, Reason
from deploy.supervisor import WORDS


def blame(runtime: Runtime, reason: int) -> str:
    """A bit set of reasons of robot 0 in words, each with the joints that it is about in this tick."""
    said = []
    for bit in Reason(reason):
        about = [*_joints(runtime, bit), *_base(runtime, bit)]
        said.append(f"{WORDS[bit]} ({', '.join(about)})" if about else WORDS[bit])
    return "; ".join(said) or "no reason"


def _joints(runtime: Runtime, bit: Reason) -> Iterator[str]:
    for name, meant in zip(runtime.spec.joint_names, _meant(runtime, bit), strict=True):
        if meant:
            yield name


def _meant(runtime: Runtime, bit: Reason) -> Bools:
    """(n,) joints that a reason is about; none where it is about the robot as a whole."""
    spec, state, estimator = runtime.spec, runtime.state, runtime.estimator
    q, limits = state.q[0], spec.joint_array
    known = {
        Reason.OUTSIDE: (q < limits("q_min")) | (q > limits("q_max")),
        Reason.TRACKING: np.abs(runtime.setpoint.q[0] - q) > spec.margins.tracking_rad,
        Reason.HEAT: (state.temperature[0] > spec.motor_array("housing_max_c"))
        | (state.hottest[0] > spec.motor_array("winding_max_c")),
        Reason.DIVERGED: estimator.diverged[0],
        Reason.STUCK: estimator.stuck[0],
        Reason.LOAD: estimator.load.against[0],
        Reason.MOVING: estimator.strays[0],
    }
    return np.asarray(known.get(bit, np.zeros(spec.n, dtype=bool)))


def _base(runtime: Runtime, bit: Reason) -> Iterator[str]:
    base = runtime.state.base
    if base is None:
        return
    if bit is Reason.DIVERGED and base.diverged[0]:
        yield "base"
    if bit is Reason.STUCK and base.stuck[0]:
        yield "IMU"
