"""Faults on schedule: who suffers what and when, and that what was scheduled really breaks."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from deploy.backends.sim.robot import SimRobot
from deploy.state import Command, Mode
from eval.faults.catalogue import JUMP, catalogue
from eval.faults.combined import ANSWER_S, FaultPair
from eval.faults.communication_faults import REBOOT_S
from eval.faults.fault_class import POLICY, SensorFault, StopCategory
from eval.faults.injector import Injector
from eval.faults.plant_effects import PlantFault
from eval.faults.schedule import FaultSettings, plan
from robots.randomness import robot_seed
from support.arm6 import SPEC, position_drives
from support.eval.fault_schedules import CLASSES, DT, N, named, one_each
from support.runtimes import Saying, running
from support.walking import QUADRUPED

FAULTS = FaultSettings(coverage=0.95, cycle_s=20.0, operator_s=5.0)
SEEDS = [robot_seed(7, robot) for robot in range(8)]
planned = partial(plan, SPEC, SPEC.sensors)
TICKS = round((3.0 + 20.0 * 2 * len(CLASSES)) / DT)


def test_classes_and_channels_are_equally_frequent():
    schedule = planned(FAULTS, SEEDS, 0, TICKS)
    assert schedule.class_index.shape == (8, 2 * len(CLASSES))
    for row in schedule.class_index:
        np.testing.assert_array_equal(np.bincount(row[: len(CLASSES)]), 1)
        assert not np.array_equal(row[: len(CLASSES)], row[len(CLASSES) :])
    assert not np.array_equal(schedule.class_index[0], schedule.class_index[1])
    for kind, fault in enumerate(CLASSES):
        given = schedule.channel[schedule.class_index == kind]
        assert set(given.tolist()) == {-1 if c is None else c for c in fault.channels}, fault.name


def test_only_the_chosen_classes_are_injected_equally_often():
    names = ("bus silent", "encoder slips", "robot two faults")
    chosen = FAULTS.model_copy(update={"classes": names})
    schedule = planned(chosen, SEEDS, 0, TICKS)
    kinds, counts = np.unique(schedule.class_index, return_counts=True)
    assert {CLASSES[k].name for k in kinds} == set(names)
    assert counts.max() - counts.min() <= len(SEEDS)
    parts = {part.fault.name for each in schedule.injections for part in each.parts}
    assert len(parts - set(names)) > 20  # pairs are of the whole catalogue


def test_slots_leave_time_to_recover_and_do_not_overlap():
    injections = planned(FAULTS, SEEDS, 0, TICKS).injections
    assert max(each.slot_end for each in injections) < TICKS
    for robot in range(8):
        mine = sorted((each for each in injections if each.robot == robot), key=lambda each: each.begins)
        for one, other in pairwise(mine):
            assert one.begins < one.ends < one.slot_end < other.begins
            assert (one.slot_end - one.ends) * DT > FAULTS.operator_s
    assert len({each.begins % 4000 for each in injections}) > 300  # not all at the same time of their slots


def renumbered(injection, first):
    """The same injection where robot `first` is the first one."""
    parts = tuple(renumbered(part, first) for part in injection.parts)
    return injection._replace(robot=injection.robot - first, parts=parts)


def test_pairs_are_two_different_faults_that_fit_into_the_slot():
    schedule = planned(FAULTS, SEEDS, 0, TICKS)
    pairs = [each for each in schedule.injections if isinstance(each.fault, FaultPair)]
    assert len(pairs) == 2 * 2 * len(SEEDS)
    for each in pairs:
        first, second = each.parts
        assert first.fault != second.fault
        assert (second.begins == each.begins) == (each.fault.failure_mode == "two faults")
        assert second.begins - each.begins <= round(ANSWER_S[1] / DT)
        assert each.ends == max(first.ends, second.ends) < each.slot_end
        names = [CLASSES[k] for k in schedule.pair[each.robot, each.slot]]
        assert names == [first.fault, second.fault]
        assert all(part.channel in part.fault.channels for part in each.parts)
    assert len({tuple(schedule.pair[each.robot, each.slot]) for each in pairs}) > 20


def test_a_reboot_silences_the_sensors_of_its_joint_for_as_long_as_it_has_no_torque():
    schedule = one_each([(named("joint drive reboots"), 2), (named("controller reboots"), None)], 10)
    silent = schedule.sensor_faults()
    assert {fault.sensor for fault in silent} == {"encoder", "current", "temperature"}
    assert all((fault.begins, fault.ends) == (10, 10 + round(REBOOT_S / DT)) for fault in silent)
    assert [fault.channel for fault in silent] == [2, 2, 2, None, None, None]


def test_schedule_depends_on_seed_and_robot_only():
    whole = planned(FAULTS, SEEDS, 0, TICKS)
    part, short = (
        planned(FAULTS, SEEDS[3:5], 3, TICKS),
        planned(FAULTS, SEEDS, 0, TICKS // 3),
    )
    np.testing.assert_array_equal(part.class_index, whole.class_index[3:5])
    np.testing.assert_array_equal(part.channel, whole.channel[3:5])
    mine = [renumbered(each, 3) for each in whole.injections if 3 <= each.robot < 5]
    assert mine == part.injections
    np.testing.assert_array_equal(short.class_index, whole.class_index[:, : short.class_index.shape[1]])
    assert not planned(None, SEEDS, 0, TICKS).injections


OF_SENSORS = [each for each in CLASSES if isinstance(each, SensorFault)]


@pytest.mark.slow
def test_every_fault_of_a_sensor_reaches_its_own_channels_and_no_others():
    """Robots that stand still, each with its own fault, beside twins that have none; a housing is warmed in both."""
    begins, seeds = 130, [robot_seed(5, robot) for robot in range(len(OF_SENSORS))]
    faults = [(each, each.channels[-1]) for each in OF_SENSORS]
    broken = SimRobot(SPEC, seeds, faults=one_each(faults, begins, lasts=150).sensor_faults())
    clean, rest = SimRobot(SPEC, seeds), np.zeros((len(seeds), N))
    drive = position_drives(len(seeds))
    off = Command(drive, q=rest, qd=rest, tau=rest, powered=rest[:, 0] > 0, current_share=rest + 1)
    differs = np.zeros((len(seeds), 300, len(SPEC.channels)), dtype=bool)
    for tick in range(300):
        for robot in (broken, clean):
            robot.goal[:] = rest[:, :3] + 0.001 * tick
            robot.write(off)
            if tick == begins:
                robot.plant.housing[:] += 20.0
        a, b = broken.read(), clean.read()
        for k, kind in enumerate(SPEC.channels):
            same = a[kind].fresh == b[kind].fresh
            same &= ((a[kind].value == b[kind].value) | np.isnan(b[kind].value)).all(axis=1)
            differs[:, tick, k] = ~same
    assert not differs[:, :begins].any()
    for robot, fault in enumerate(OF_SENSORS):
        expected = [kind == fault.component for kind in SPEC.channels]
        assert differs[robot].any(axis=0).tolist() == expected, fault.name


TIMED = ("encoder off", "encoder stuck", "current off", "current stuck", "temperature off")
"""Faults that deploy has a timer for, which ends in a stop."""


@pytest.mark.slow
def test_faults_last_longer_than_the_detection_times_of_deploy():
    faults, begins = [named(name) for name in TIMED], 70
    schedule = one_each([(each, None) for each in faults], begins)
    runtime = running(len(faults), faults=schedule.sensor_faults())
    at_work = np.ones(len(faults), dtype=bool)
    for tick in range(runtime.ticks, max(each.ends for each in schedule.injections)):
        runtime.tick()
        goes_on = np.array([tick < each.ends for each in schedule.injections])
        at_work &= (runtime.supervisor.mode == Mode.RUNNING) | ~goes_on
    assert [each.name for each, unnoticed in zip(faults, at_work, strict=True) if unnoticed] == []


def test_every_policy_fault_reaches_the_runtime():
    faults = [each for each in CLASSES if each.component == POLICY]
    schedule = one_each([(each, each.channels[-1]) for each in faults] + [None], 10, lasts=10)
    injector = Injector(SPEC, schedule, running(len(faults) + 1).robot.plant, N)
    rng = np.random.default_rng(0)
    heard, said = [], []
    for tick in range(0, 30, 4):
        injector.step(tick)
        said.append(rng.uniform(-1, 1, (len(faults) + 1, N)).astype(np.float32))
        heard.append(injector.action(said[-1], tick // 4))
    before, during, after = slice(0, 3), slice(3, 5), slice(5, None)
    heard, said = np.array(heard), np.array(said)
    np.testing.assert_array_equal(heard[before], said[before])
    np.testing.assert_array_equal(heard[after], said[after])
    np.testing.assert_array_equal(heard[:, -1], said[:, -1])
    by = {each.failure_mode: heard[during, robot] for robot, each in enumerate(faults)}
    assert np.isnan(by["nan"][:, -1]).all()
    assert np.isinf(by["infinite"][:, -1]).all()
    assert (by["runs away"][:, -1] == JUMP).all()
    assert np.array_equal(by["stalls"], np.tile(heard[2, 2], (2, 1)))
    assert np.array_equal(by["jumps"][:, 0], [JUMP, -JUMP])
    assert len(by) == len(faults)


def test_every_plant_fault_changes_its_robot_only_and_is_undone():
    faults = [each for each in CLASSES if isinstance(each, PlantFault)]
    joint, begins, lasts, robots = 1, 40, 60, len(faults) + 1
    each_its_own = [(each, joint if len(each.channels) > 1 else None) for each in faults]
    schedule, rows = (
        one_each([*each_its_own, None], begins, lasts=lasts),
        [each.failure_mode for each in faults],
    )
    worlds = [running(robots, policy=Saying(robots)) for _ in range(2)]
    for world in worlds:
        world.policy.action[:, :2] = 0.4, -0.4
    plant = worlds[0].robot.plant
    injector, batch = Injector(SPEC, schedule, plant, N), plant.batch
    as_built = {
        name: batch.expand(name).copy() for name in ("tendon_stiffness", "tendon_lengthspring", "body_mass")
    }
    for tick in range(begins + lasts + 10):
        injector.step(tick)
        limit = plant.supply.limit.copy()
        for world in worlds:
            world.tick()
        broken, clean = (world.robot.truth() for world in worlds)
        same = ((broken.q == clean.q) & (broken.winding_c == clean.winding_c)).all(axis=1)
        assert same.all() if tick < begins else same[-1]
        if tick == begins + 5:  # later it has stopped, and brakes need no voltage
            assert (limit[rows.index("supply sags")] < 31).all()
            assert plant.braked[rows.index("supply drops")]
            assert (limit[rows.index("drive dead")] < 1).tolist() == [k == joint for k in range(N)]
        if tick == begins + lasts - 1:
            alike = [what for what, one in zip(rows, same, strict=False) if one]
            assert set(alike) <= {"supply sags"}  # which slows only who is fast
            blocked = rows.index("blocked"), joint
            # MuJoCo's friction gives way in proportion: rad/s
            yielding = 1.2e-3 * np.abs(broken.tau[blocked])
            assert np.abs(broken.qd[blocked]) < yielding + 0.01
            housing = (broken.housing_c - clean.housing_c)[rows.index("housing hot")]
            assert housing[joint] == pytest.approx(6.0 * lasts * DT)
            winding = (broken.winding_c - clean.winding_c)[rows.index("winding short")]
            assert winding[joint] == pytest.approx(15.0 * lasts * DT, rel=0.1)
    for name, array in as_built.items():
        np.testing.assert_array_equal(batch.expand(name), array)
    np.testing.assert_array_equal(batch.expand("dof_frictionloss")[:, plant.wear.dofs], plant.wear.friction)
    assert (plant.supply.limit > 20).all()
    np.testing.assert_allclose(worlds[0].robot.truth().housing_c, worlds[1].robot.truth().housing_c, atol=1.0)


def test_short_circuit_without_power_heats_nothing_and_brakes_hold():
    runtime = running(3)
    schedule = one_each(
        [(named("joint winding short"), 2), (named("joint drive dead"), 1), None], 0, lasts=50
    )
    injector = Injector(SPEC, schedule, runtime.robot.plant, N)
    runtime.supervisor.disarm(np.ones(3, dtype=bool))
    runtime.tick()
    assert (runtime.supervisor.mode == Mode.DISARMED).all()
    winding, limit = runtime.robot.truth().winding_c.copy(), runtime.robot.plant.supply.limit
    for tick in range(50):
        injector.step(tick)
        assert (limit > 20).all()
    np.testing.assert_array_equal(runtime.robot.truth().winding_c, winding)


@pytest.mark.parametrize("kind", ["gyro", "accelerometer"])
def test_walking_robot_latches_without_its_imu(kind):
    answers = {each.answer for each in catalogue(QUADRUPED, QUADRUPED.sensors) if each.component == kind}
    assert answers == {StopCategory.CATEGORY_1}
