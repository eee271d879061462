"""When which fault befalls which robot: a function of seed, robot and tick."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple, cast

import numpy as np

from deploy.backends.sim.packets import Fault
from eval.faults.faults import FaultClass, catalogue
from eval.soak.profile import HOURS_MAX, Faults
from robots.randomness import Keys, keyed, keys
from robots.sensors import Kind
from robots.spec import RobotSpec

PURPOSE = 6
"""Of the stream of random numbers."""
FIRST_S, SPREAD_S = 3.0, 2.0
"""s until the first slot of a robot begins, and s over which a fault may begin in its slot: each in another motion."""
SLOTS_MAX = 10_000
"""Faults of a robot: all of them are planned before the first."""


class Injection(NamedTuple):
    """One fault of one robot, ticks from `begins` to just before `ends`; `over` is the last tick of its slot."""

    robot: int
    slot: int
    fault: FaultClass
    channel: int | None
    begins: int
    ends: int
    over: int


class Schedule:
    """What is to befall B robots, each once in each of its S slots.

    Attributes:
        injections: all of them.
        kind: (B, S) place in the catalogue. channel: (B, S), -1 for all.
    """

    def __init__(self, classes: Sequence[FaultClass], robots: int, injections: Sequence[Injection]) -> None:
        """Put them in order.

        Args:
            classes: the catalogue. robots: B. injections: one for every robot and slot.
        """
        self.injections = injections
        shape = robots, 1 + max((each.slot for each in injections), default=-1)
        self.kind, self.channel = np.zeros((2, *shape), dtype=np.int64)
        self._begin, self._end = (
            defaultdict[int, list[Injection]](list),
            defaultdict[int, list[Injection]](list),
        )
        for each in injections:
            place = each.robot, each.slot
            self.kind[place] = classes.index(each.fault)
            self.channel[place] = -1 if each.channel is None else each.channel
            self._begin[each.begins].append(each)
            self._end[each.ends].append(each)

    def beginning(self, tick: int) -> Sequence[Injection]:
        """What begins at a tick."""
        return self._begin.get(tick, ())

    def ending(self, tick: int) -> Sequence[Injection]:
        """What is over at a tick, for the first time."""
        return self._end.get(tick, ())

    def during(self, tick: int) -> list[Injection]:
        """What goes on at a tick."""
        return [each for each in self.injections if each.begins <= tick < each.ends]

    def of_sensors(self) -> tuple[Fault, ...]:
        """What sensors must be told in advance."""
        return tuple(
            Fault(
                robot=each.robot,
                sensor=cast(Kind, each.fault.where),
                what=each.fault.failure,
                channel=each.channel,
                begins=each.begins,
                ends=each.ends,
            )
            for each in self.injections
            if each.fault.failure is not None
        )


def hours_max(faults: Faults | None) -> float:
    """Hours that a robot may be asked to live; None for no fault."""
    return min(HOURS_MAX, (FIRST_S + SLOTS_MAX * faults.cycle_s) / 3600) if faults else HOURS_MAX


def plan(
    spec: RobotSpec, faults: Faults | None, seeds: Sequence[np.random.SeedSequence], first: int, ticks: int
) -> Schedule:
    """Slots of one length, in each of which every robot suffers one fault and has time to recover.

    Args:
        spec: the robot.
        faults: what was asked for; None for no fault.
        seeds: B seeds. first: the number of the first of these robots in the soak.
        ticks: that will be lived; a slot that does not fit is left out.
    """
    classes = catalogue(spec)
    if faults is None:
        return Schedule(classes, len(seeds), ())
    opens = range(round(FIRST_S / spec.dt), ticks, round(faults.cycle_s / spec.dt))
    injections = [
        injection
        for robot, key in enumerate(keys(seeds, PURPOSE))
        for injection in _of_robot(classes, robot, first + robot, key, opens, spec.dt)
        if opens[injection.slot] + opens.step <= ticks
    ]
    return Schedule(classes, len(seeds), injections)


def _of_robot(
    classes: Sequence[FaultClass], robot: int, number: int, key: Keys, opens: range, dt: float
) -> Iterator[Injection]:
    """All classes in a new order each time; channels in turn, so that each comes up as often as any other."""
    many, spread = len(classes), round(SPREAD_S / dt)
    for slot, begin in enumerate(opens):
        turn, place = divmod(slot, many)
        if place == 0:
            rng = keyed(key, turn)
            order, late = rng.permutation(many), rng.integers(0, spread, many)
        fault = classes[order[place]]
        begins = begin + int(late[place])
        yield Injection(
            robot=robot,
            slot=slot,
            fault=fault,
            channel=fault.channels[(number + turn + order[place]) % len(fault.channels)],
            begins=begins,
            ends=begins + round(fault.lasts_s / dt),
            over=begin + opens.step - 1,
        )
