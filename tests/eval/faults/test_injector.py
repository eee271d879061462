"""Fault classes that are declared here, outside the catalogue, are injected like those of the catalogue."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.faults.fault_class import JOINT, PolicyFault, StopCategory
from eval.faults.injector import Injector
from eval.faults.plant_effects import PlantFault
from eval.faults.schedule import Schedule
from support.arm6 import SPEC
from support.eval.fault_schedules import CLASSES, N, named, one_each
from support.runtimes import running


def weaken(access, injection, active):
    access.set_voltage(injection.robot, 0.5 if active else 1.0, injection.channel)


def negate(call):
    call.action[call.channel] *= -1.0


WEAK = PlantFault(
    component=JOINT, failure_mode="weak", channels=(2,), meaning="half of its voltage", effect=weaken
)
MIRRORED = PolicyFault(
    failure_mode="mirrored", answer=StopCategory.CATEGORY_2, meaning="one sign is wrong", effect=negate
)


def test_faults_from_outside_the_catalogue():
    assert (WEAK.name, MIRRORED.name) == ("joint weak", "policy mirrored")
    plant = running(3).robot.plant
    schedule = one_each([(WEAK, 2), (MIRRORED, 1), None], 10, lasts=5, classes=(*CLASSES, WEAK, MIRRORED))
    injector, usual = Injector(SPEC, schedule, plant, N), plant.supply.limit.copy()
    action = np.ones((3, N), dtype=np.float32)
    share, mirrored = np.ones((3, N)), action.copy()
    share[0, 2], mirrored[1, 1] = 0.5, -1.0
    for tick in range(20):
        injector.step(tick)
        active = 10 <= tick < 15
        np.testing.assert_array_equal(plant.supply.limit, usual * share if active else usual)
        np.testing.assert_array_equal(injector.action(action, tick), mirrored if active else action)


PAIRS = {
    ("bus silent", "bus loses every second"): ([True] * 5, [0] * 5, [0] * 5),
    ("bus delays", "bus repeats"): ([False] * 5, [10] * 5, [0] * 5),
    ("bus repeats", "bus loses every second"): ([True, False] * 2 + [True], [5, 0, 0, 0, 0], [0] * 5),
    ("computer hangs", "computer stalls"): ([False] * 5, [0] * 5, [70, 0, 0, 0, 0]),
}
"""Commands that are lost, ticks by which they are old, and slots that are skipped, tick by tick."""


def test_two_faults_at_once_add_up_in_either_order_and_end():
    plant = running(2 * len(PAIRS)).robot.plant
    pairs = [*PAIRS, *(pair[::-1] for pair in PAIRS)]
    single = [one_each([(named(pair[k]), None) for pair in pairs], 10, lasts=5).injections for k in range(2)]
    injector = Injector(SPEC, Schedule(CLASSES, len(pairs), [*single[0], *single[1]]), plant, N)
    seen = np.zeros((20, 3, len(pairs)), dtype=np.int64)
    for tick in range(20):
        injector.step(tick)
        seen[tick] = plant.bus.lost, plant.bus.late, plant.late
        plant.late[:] = 0
    assert not seen[:10].any()
    assert not seen[15:].any()
    for robot, expected in enumerate([*PAIRS.values()] * 2):
        np.testing.assert_array_equal(seen[10:15, :, robot].T, expected)
