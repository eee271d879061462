"""Explanation of reasons for the operator: the joints, shapes or checks that each one is about."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deploy.reasons import REASONS, Reason
from deploy.runtime import Runtime
from deploy.state import Mode
from robots.arrays import Bools

AGES = (Reason.STALE, Reason.LOST)
"""Reasons that are about the age of samples."""


class StopDetector:
    """Detector of robots that begin to stop, in the tick in which they do: only then the cause can be read."""

    def __init__(self) -> None:
        """Start with all robots disarmed."""
        self._mode: NDArray[np.int8] | Mode = Mode.DISARMED

    def step(self, runtime: Runtime) -> list[int]:
        """Return robots that began to stop, or lost power without a stop, in the tick that has just ended."""
        mode, before = runtime.supervisor.mode, self._mode
        stopping = (mode == Mode.STOPPING) & (before != Mode.STOPPING)
        cut = (mode == Mode.LATCHED) & ((before == Mode.RUNNING) | (before == Mode.ARMING))
        self._mode = mode.copy()
        return np.flatnonzero(stopping | cut).tolist()


class StopExplanation:
    """Explanation of the reasons of robot 0, each as of the tick in which it came: later its cause may be gone."""

    def __init__(self) -> None:
        """Start without reasons."""
        self._texts: dict[Reason, str] = {}

    def __str__(self) -> str:
        """All of them; empty where there is none."""
        return "; ".join(self._texts.values())

    def step(self, runtime: Runtime) -> None:
        """Read the tick that has just ended."""
        reasons = Reason(int(runtime.supervisor.reason[0]))
        self._texts = {bit: self._texts.get(bit) or explain_reasons(runtime, bit) for bit in reasons}


def explain_reasons(runtime: Runtime, reason: int, robot: int = 0) -> str:
    """Return a robot's bit set of reasons as text, each with the joints, shapes or checks that it is about."""
    texts = []
    for bit in Reason(reason):
        about = [*_joint_names(runtime, bit, robot), *_parts(runtime, bit, robot)]
        texts.append(f"{REASONS[bit].text} ({', '.join(about)})" if about else REASONS[bit].text)
    return "; ".join(texts) or "no reason"


def _joint_names(runtime: Runtime, bit: Reason, robot: int) -> Iterator[str]:
    """Names of joints; none where all are meant."""
    joints = _joints(runtime, bit, robot)
    if not joints.all():
        yield from np.array(runtime.spec.joint_names)[joints].tolist()


def _joints(runtime: Runtime, bit: Reason, robot: int) -> Bools:
    """Return (n,) joints that a reason is about; none where it is about the robot as a whole."""
    estimator, windings = runtime.estimator, runtime.estimator.windings
    if bit is Reason.HEAT and windings.unknown[robot]:
        return np.asarray(~windings.valid[robot])
    if bit in AGES:
        old = runtime.state.t - estimator.joints.t_sample[robot] > _age_max(runtime, bit)
        return np.asarray(old | ~estimator.joints.confirmed[robot])
    estimated = {
        Reason.DIVERGED: estimator.diverged,
        Reason.STUCK: estimator.stuck,
        Reason.LOAD: estimator.external_torque.detected,
        Reason.MOVING: runtime.moving,
        Reason.OSCILLATION: estimator.oscillation.oscillating,
    }
    if bit in estimated:
        return np.asarray(estimated[bit][robot])
    joints = np.zeros(runtime.spec.n, dtype=bool)
    for failed in runtime.safety.failed(runtime.verdict, robot, bit).values():
        joints |= failed
    return joints


def _parts(runtime: Runtime, bit: Reason, robot: int) -> Iterator[str]:
    """Shapes, checks where several have the reason, a failure of the policy, and sensors of a floating base."""
    safety, base = runtime.safety, runtime.state.base
    if bit is Reason.NOT_FINITE and runtime.policy and runtime.policy.failure:
        yield f"the policy failed: {runtime.policy.failure}"
    if bit is Reason.COLLISION and (shapes := safety.colliding_shapes(runtime.verdict, robot)):
        yield " and ".join(shapes)
    if len(names := safety.names(bit)) > 1:
        yield from (name for name in safety.failed(runtime.verdict, robot, bit) if name in names)
    if base is None:
        return
    if bit is Reason.DIVERGED and base.diverged[robot]:
        yield "base"
    if (bit is Reason.STUCK and base.stuck[robot]) or (
        bit in AGES and base.age[robot] > _age_max(runtime, bit)
    ):
        yield "IMU"


def _age_max(runtime: Runtime, bit: Reason) -> float:
    """Return s that a sample may be old."""
    margins = runtime.spec.margins
    return margins.stale_s if bit is Reason.STALE else margins.lost_s
