"""Injection of scheduled faults into plant and policy; simulated sensors inject their own from the schedule."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.plant import Plant
from deploy.stage import Stage
from eval.faults.fault_class import ActionFault, Injection, PolicyFault
from eval.faults.plant_effects import PlantAccess, PlantFault
from eval.faults.schedule import Schedule
from robots.arrays import Float32s
from robots.spec import RobotSpec

_NEVER = -1


class Injector(Stage):
    """Applies scheduled faults tick by tick, and repairs them at their ends.

    Attributes:
        last_action: (B, A) the newest action, faults included.
    """

    carried: ClassVar[tuple[str, ...]] = ("last_action",)

    def __init__(self, spec: RobotSpec, schedule: Schedule, plant: Plant, actions: int) -> None:
        """Allocate for a new plant, and for A numbers in the policy's action."""
        self._schedule, self._access = schedule, PlantAccess(spec, plant)
        self.last_action = np.zeros((plant.batch.nsim, actions), dtype=np.float32)
        self._active: list[Injection] = []
        self._next_tick = _NEVER

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore saved arrays. The next step applies active faults again."""
        super().restore(arrays)
        self._access.repair_cables()
        self._next_tick = _NEVER

    def step(self, tick: int) -> None:
        """Repair faults of the plant that end at a tick, and apply those that are active, before that tick."""
        schedule = self._schedule
        ending = schedule.ending(tick)
        if tick != self._next_tick or ending or schedule.beginning(tick):
            self._active = schedule.active(tick)
        self._access.tick, self._next_tick = tick, tick + 1
        for injection in (*ending, *self._active):
            self._access.plant.bus.repair(injection.robot)
        for injections, active in ((ending, False), (self._active, True)):
            for injection in injections:
                if isinstance(injection.fault, PlantFault):
                    injection.fault.effect(self._access, injection, active)

    def action(self, action: Float32s, call: int) -> Float32s:
        """Return the policy's action (B, A) with the faults of the policy; `call` is the number of its call."""
        changed = action.copy()
        for robot, _, fault, channel, *_ in self._active:
            if isinstance(fault, PolicyFault):
                fault.effect(ActionFault(changed[robot], self.last_action[robot], channel, call))
        self.last_action[:] = changed
        return changed
