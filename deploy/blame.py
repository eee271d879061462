"""Which joints or shapes a reason is about: for the operator, who has to do something about it."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deploy.runtime import Runtime
from deploy.state import Bools, Mode, Reason
from deploy.supervisor import WORDS


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
    estimator = runtime.estimator
    known = {
        Reason.DIVERGED: estimator.diverged,
        Reason.STUCK: estimator.stuck,
        Reason.LOAD: estimator.load.against,
        Reason.MOVING: estimator.strays,
    }
    if bit in known:
        return np.asarray(known[bit][robot])
    return runtime.safety.joints(runtime.verdict, robot, bit)


def _parts(runtime: Runtime, bit: Reason, robot: int) -> Iterator[str]:
    """What else a robot has."""
    if bit is Reason.COLLISION and bit & runtime.verdict.reason[robot]:
        yield " and ".join(runtime.safety.nearest(runtime.verdict, robot))
    base = runtime.state.base
    if base is None:
        return
    if bit is Reason.DIVERGED and base.diverged[robot]:
        yield "base"
    if bit is Reason.STUCK and base.stuck[robot]:
        yield "IMU"
