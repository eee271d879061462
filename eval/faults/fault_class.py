"""Fault classes: one declaration for each, with what it injects and the expected answer of the robot.

Source of classes and answers: PX4 Autopilot, failure injection (sensors); Franka Control Interface, 20 missed packets
(bursts); stop categories of IEC 60204-1. Sizes and durations are estimates.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple, Self

import numpy as np

from deploy.backends.sim.sensor_faults import Failure
from robots.arrays import Float32s
from robots.spec import RobotSpec


class StopCategory(IntEnum):
    """Answers of a robot to a fault, in the order of severity: stop categories of IEC 60204-1, or no stop."""

    NO_STOP = 0
    CATEGORY_2 = 1
    CATEGORY_1 = 2
    CATEGORY_0 = 3


CATEGORY_NAMES = {
    StopCategory.NO_STOP: "go on",
    StopCategory.CATEGORY_2: "category 2",
    StopCategory.CATEGORY_1: "category 1",
    StopCategory.CATEGORY_0: "category 0",
}
"""Texts of the answers in report.json."""

SOON_S = 3.0
"""Duration of most faults, s: longer than the timers of deploy that wait for them."""
POLICY, JOINT, ROBOT = "policy", "joint", "robot"


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultClass:
    """One thing that can fail, in one place.

    Attributes:
        component: a kind of sensor, the policy, a joint or the whole robot. failure_mode: short name for the report.
        channels: numbers of the sensor's channels, or of joints, that can fail alone; None for all at once.
        per_joint: each joint's action can fail alone, as every fault of a joint can.
        lasts_s: s, from the first sign to the last.
        answer: the most severe one that is right; a gentler one is too, as long as no hard monitor fires.
        meaning: for the report.
    """

    component: str
    failure_mode: str
    channels: tuple[int | None, ...] = (None,)
    per_joint: bool = False
    lasts_s: float = SOON_S
    answer: StopCategory = StopCategory.CATEGORY_1
    meaning: str

    @property
    def name(self) -> str:
        """Unique name in the catalogue."""
        return f"{self.component} {self.failure_mode}"

    def of_robot(self, spec: RobotSpec) -> Self:
        """Return the class with the channels of a robot."""
        return (
            replace(self, channels=tuple(range(spec.n)))
            if self.per_joint or self.component == JOINT
            else self
        )

    def parts(self, channel: int | None, rng: np.random.Generator) -> "tuple[Part, ...]":
        """Return the faults that one injection consists of; `rng` draws them where they are random."""
        return (Part(self, channel, 0.0),)


class Part(NamedTuple):
    """One fault of an injection, `after_s` s after its begin; `channel` as in `Injection`."""

    fault: FaultClass
    channel: int | None
    after_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFault(FaultClass):
    """Failure of a sensor's packets, injected by the simulated sensors.

    Attributes:
        failure: of the packets.
    """

    failure: Failure


class Injection(NamedTuple):
    """One fault of one robot, in ticks from `begins` to just before `ends`; `slot_end` is the last tick of its slot.

    `parts` are the faults that it consists of, if it is not one fault alone.
    """

    robot: int
    slot: int
    fault: FaultClass
    channel: int | None
    begins: int
    ends: int
    slot_end: int
    parts: "tuple[Injection, ...]" = ()


class ActionFault(NamedTuple):
    """Action of one call of the policy, to be changed in place.

    Attributes:
        action: (A,) of the robot. last: (A,) the action of the call before, faults included.
        channel: number of the action; None for all. call: number of the policy's call, from 0.
    """

    action: Float32s
    last: Float32s
    channel: int | None
    call: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyFault(FaultClass):
    """Wrong action of the policy.

    Attributes:
        effect: changes the action (A,) of the robot in place, at each call of the policy.
    """

    component: str = POLICY
    effect: Callable[[ActionFault], None]
