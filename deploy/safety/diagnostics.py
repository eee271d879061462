"""Which joints or shapes a reason is about: for the operator, who has to do something about it."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deploy.runtime import Runtime
from deploy.safety.supervisor import WORDS
from deploy.state import Mode, Reason
from robots.arrays import Bools

AGES = (Reason.STALE, Reason.LOST)
"""Reasons that are about the age of samples."""


class Stops:
    """Notices robots that leave their work, in the tick in which they do: only then it is known what it was about."""

    def __init__(self) -> None:
        """Nobody works yet."""
        self._mode: NDArray[np.int8] | Mode = Mode.DISARMED

    def begun(self, runtime: Runtime) -> list[int]:
        """Robots that began to stop, or lost their power at work, in the tick that has just ended."""
        mode, before = runtime.supervisor.mode, self._mode
        stopping = (mode == Mode.STOPPING) & (before != Mode.STOPPING)
        cut = (mode == Mode.LATCHED) & (before == Mode.RUNNING)
        self._mode = mode.copy()
        return np.flatnonzero(stopping | cut).tolist()


class Why:
    """Why robot 0 does not run, each reason in the words of the tick in which it came: later it may be about less."""

    def __init__(self) -> None:
        """It has none yet."""
        self._told: dict[Reason, str] = {}

    def __str__(self) -> str:
        """In words; empty where it has none."""
        return "; ".join(self._told.values())

    def step(self, runtime: Runtime) -> None:
        """Look at the tick that has just ended."""
        reasons = Reason(int(runtime.supervisor.reason[0]))
        self._told = {bit: self._told.get(bit) or blame(runtime, bit) for bit in reasons}


def blame(runtime: Runtime, reason: int, robot: int = 0) -> str:
    """A bit set of reasons of a robot in words, each with the joints or shapes that it is about in this tick."""
    said = []
    for bit in Reason(reason):
        about = [*_joints(runtime, bit, robot), *_parts(runtime, bit, robot)]
        said.append(f"{WORDS[bit]} ({', '.join(about)})" if about else WORDS[bit])
    return "; ".join(said) or "no reason"


def _joints(runtime: Runtime, bit: Reason, robot: int) -> Iterator[str]:
    """Names of joints; none where all are meant."""
    meant = _meant(runtime, bit, robot)
    if not meant.all():
        yield from np.array(runtime.spec.joint_names)[meant].tolist()


def _meant(runtime: Runtime, bit: Reason, robot: int) -> Bools:
    """(n,) joints that a reason is about; none where it is about the robot as a whole."""
    estimator, windings = runtime.estimator, runtime.estimator.windings
    if bit is Reason.HEAT and windings.unknown[robot]:
        return np.asarray(~windings.valid[robot])
    if bit in AGES:
        old = runtime.state.t - estimator.joints.t_sample[robot] > _oldest(runtime, bit)
        return np.asarray(old | ~estimator.divergence.confirmed[robot])
    known = {
        Reason.DIVERGED: estimator.diverged,
        Reason.STUCK: estimator.stuck,
        Reason.LOAD: estimator.external_torque.detected,
        Reason.MOVING: estimator.moving,
    }
    if bit in known:
        return np.asarray(known[bit][robot])
    return runtime.safety.joints(runtime.verdict, robot, bit)


def _parts(runtime: Runtime, bit: Reason, robot: int) -> Iterator[str]:
    """What else a robot has."""
    if bit is Reason.COLLISION and (shapes := runtime.safety.meeting(runtime.verdict, robot)):
        yield " and ".join(shapes)
    base = runtime.state.base
    if base is None:
        return
    if bit is Reason.DIVERGED and base.diverged[robot]:
        yield "base"
    if (bit is Reason.STUCK and base.stuck[robot]) or (
        bit in AGES and base.age[robot] > _oldest(runtime, bit)
    ):
        yield "IMU"


def _oldest(runtime: Runtime, bit: Reason) -> float:
    """S that a sample may be old."""
    margins = runtime.spec.margins
    return margins.stale_s if bit is Reason.STALE else margins.lost_s
