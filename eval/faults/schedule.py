"""Fault schedule: its settings, and the fault of each robot in each slot as a function of seed, robot and tick."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from deploy.backends.sim.sensor_faults import Fault
from eval.faults.catalogue import catalogue
from eval.faults.combined import FaultPair
from eval.faults.fault_class import FaultClass, Injection, Part, SensorFault
from robots.randomness import Keys, Stream, generator_at, stream_keys
from robots.sensors import Kind
from robots.spec import RobotSpec
from robots.strict import Many, Strict

FIRST_S, SPREAD_S = 3.0, 2.0
"""Begin of the first slot, s, and span in which a fault begins in its slot, s, so that each meets another motion."""
SLOTS_MAX = 10_000
"""Most faults of a robot, since all are planned at the start."""
HOURS_MAX = 10_000.0
"""Upper bound of the simulated hours of a robot."""
SECONDS_MAX = 3600 * HOURS_MAX
_PARTS_FROM = 2**32
"""Counter of the random numbers of the first slot's parts; below it are those of the rounds."""
LEAST_CYCLE_S = 18.0
"""s that the longest fault, the operator's delay and a restart take at least."""


class FaultSettings(Strict):
    """Timing of fault injection: each robot gets one fault of every class in turn, in an order of its own.

    Attributes:
        coverage: required share of handled injections in each class, to be shown with 95 % confidence.
        cycle_s: s from one fault of a robot to its next.
        operator_s: s until a robot without power is armed again; shorter than without faults.
        classes: names of the classes that are injected, as `FaultClass.name`; None for the whole catalogue.
    """

    coverage: Annotated[float, Field(gt=0, lt=1)]
    cycle_s: Annotated[float, Field(ge=LEAST_CYCLE_S, le=SECONDS_MAX)]
    operator_s: Annotated[float, Field(ge=0, le=LEAST_CYCLE_S)]
    classes: Annotated[Many[str], Field(min_length=1)] | None = None

    def injects(self, fault: FaultClass) -> bool:
        """Return whether a class is injected."""
        return self.classes is None or fault.name in self.classes


class Schedule:
    """Injections of B robots, one in each of S slots.

    Attributes:
        injections: all of them. faults: those that they consist of.
        class_index: (B, S) place in the catalogue. channel: (B, S), -1 for all.
        pair: (B, S, 2) places of both faults of a pair, -1 for others.
    """

    def __init__(self, classes: Sequence[FaultClass], robots: int, injections: Sequence[Injection]) -> None:
        """Sort the injections, one for each of B robots and slot, by ticks; `classes` is the catalogue."""
        self.injections = injections
        shape = robots, 1 + max((injection.slot for injection in injections), default=-1)
        self.class_index, self.channel = np.zeros((2, *shape), dtype=np.int64)
        self.pair = np.full((*shape, 2), -1)
        self.faults = [fault for injection in injections for fault in _single(injection)]
        for injection in injections:
            place = injection.robot, injection.slot
            self.class_index[place] = classes.index(injection.fault)
            self.channel[place] = -1 if injection.channel is None else injection.channel
            if isinstance(injection.fault, FaultPair):
                self.pair[place] = [classes.index(part.fault) for part in injection.parts]
        self._injected = _by_tick((each.begins, each) for each in injections)
        self._begin = _by_tick((fault.begins, fault) for fault in self.faults)
        self._end = _by_tick((fault.ends, fault) for fault in self.faults)

    def injected(self, tick: int) -> Sequence[Injection]:
        """Return the injections whose first tick it is."""
        return self._injected.get(tick, ())

    def beginning(self, tick: int) -> Sequence[Injection]:
        """Return the faults whose first tick it is."""
        return self._begin.get(tick, ())

    def ending(self, tick: int) -> Sequence[Injection]:
        """Return the faults whose first tick without them it is."""
        return self._end.get(tick, ())

    def active(self, tick: int) -> list[Injection]:
        """Return the faults that are active at a tick."""
        return [fault for fault in self.faults if fault.begins <= tick < fault.ends]

    def sensor_faults(self) -> tuple[Fault, ...]:
        """Return the faults that simulated sensors must know in advance."""
        return tuple(
            Fault(
                robot=robot,
                sensor=fault.component,
                what=fault.failure,
                channel=channel,
                begins=begins,
                ends=ends,
            )
            for robot, _, fault, channel, begins, ends, *_ in self.faults
            if isinstance(fault, SensorFault)
        )


def _single(injection: Injection) -> Iterator[Injection]:
    """Yield the faults that an injection consists of, down to those that consist of no others."""
    if not injection.parts:
        yield injection
    for part in injection.parts:
        yield from _single(part)


def _by_tick(items: Iterable[tuple[int, Injection]]) -> dict[int, list[Injection]]:
    found = defaultdict[int, list[Injection]](list)
    for tick, injection in items:
        found[tick].append(injection)
    return found


def hours_max(faults: FaultSettings | None) -> float:
    """Return the most hours that can be simulated; None for no faults."""
    return min(HOURS_MAX, (FIRST_S + SLOTS_MAX * faults.cycle_s) / 3600) if faults else HOURS_MAX


def plan(
    spec: RobotSpec,
    read: Collection[Kind],
    faults: FaultSettings | None,
    seeds: Sequence[np.random.SeedSequence],
    first: int,
    ticks: int,
) -> Schedule:
    """Plan slots of equal length, with one fault and the time to recover in each slot of every robot.

    The B seeds belong to the robots from number `first` on. A slot that does not fit into `ticks` is left out. Sensors
    that are not among those `read` do not fail.
    """
    classes = catalogue(spec, read)
    if faults is None:
        return Schedule(classes, len(seeds), ())
    injected = [each for each in classes if faults.injects(each)]
    slots = range(round(FIRST_S / spec.dt), ticks, round(faults.cycle_s / spec.dt))
    injections = [
        injection
        for robot, key in enumerate(stream_keys(seeds, Stream.FAULTS))
        for injection in _robot_injections(injected, robot, first + robot, key, slots, spec.dt)
        if slots[injection.slot] + slots.step <= ticks
    ]
    return Schedule(classes, len(seeds), injections)


def _robot_injections(
    classes: Sequence[FaultClass], robot: int, number: int, key: Keys, slots: range, dt: float
) -> Iterator[Injection]:
    """Yield all classes in a new order in each round; channels take turns, so that each comes up equally often."""
    count, spread = len(classes), round(SPREAD_S / dt)
    for slot, begin in enumerate(slots):
        turn, place = divmod(slot, count)
        if place == 0:
            rng = generator_at(key, turn)
            order, delay = rng.permutation(count), rng.integers(0, spread, count)
        fault = classes[order[place]]
        begins = begin + int(delay[place])
        injection = Injection(
            robot=robot,
            slot=slot,
            fault=fault,
            channel=fault.channels[(number + turn + order[place]) % len(fault.channels)],
            begins=begins,
            ends=begins + round(fault.lasts_s / dt),
            slot_end=begin + slots.step - 1,
        )
        yield with_parts(injection, generator_at(key, _PARTS_FROM + slot), dt)


def with_parts(injection: Injection, rng: np.random.Generator, dt: float) -> Injection:
    """Return an injection with the faults that it consists of; `rng` draws those that are random."""
    parts = injection.fault.parts(injection.channel, rng)
    if len(parts) == 1:
        return injection
    faults = tuple(with_parts(_part(injection, part, dt), rng, dt) for part in parts)
    return injection._replace(ends=max(fault.ends for fault in faults), parts=faults)


def _part(injection: Injection, part: Part, dt: float) -> Injection:
    begins = injection.begins + round(part.after_s / dt)
    ends = begins + round(part.fault.lasts_s / dt)
    return injection._replace(fault=part.fault, channel=part.channel, begins=begins, ends=ends)
