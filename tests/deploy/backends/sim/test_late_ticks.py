"""Robots whose computer is late: they go on under the last command, and the runtime's clock does not count it."""

import numpy as np
import pytest

from support.arm6 import SPEC
from support.deploy.plants import DT, HOME, N, command, exact
from support.runtimes import Saying, running

pytest.importorskip("mujoco")

LATE = 7


def led(plant, ticks, begin=0, speed=0.4):
    for k in range(begin, begin + ticks):
        plant.step(command(np.tile(HOME + speed * k * DT, (len(plant.valid), 1)), speed))


def test_a_wait_equals_periods_in_which_the_bus_loses_the_command():
    """The same physics by another way, but for supply and heat, which keep to the ticks."""
    late, lossy = (exact(2, {"drives.delay_s": 0.003}) for _ in range(2))
    for plant in (late, lossy):
        led(plant, 41)
    for k in range(LATE):
        late.wait(0)
        lossy.bus.lost[0] = True
        lossy.step(command(np.tile(HOME + 0.4 * (41 + k) * DT, (2, 1)), 0.4))
    np.testing.assert_allclose(late.q[0], lossy.q[0], atol=1e-6)
    np.testing.assert_allclose(late.qd[0], lossy.qd[0], atol=1e-4)
    np.testing.assert_array_equal(late.drives.history[0], lossy.drives.history[0])
    np.testing.assert_allclose(late.tool_velocity[0], lossy.tool_velocity[0], atol=1e-4)
    np.testing.assert_allclose(late.travel[0], lossy.travel[0], rtol=1e-4)


def test_a_wait_leaves_other_robots_where_they_are():
    plant, twin = exact(3), exact(3)
    for each in (plant, twin):
        led(each, 40)
    plant.wait(1)
    others = [0, 2]
    for each in (plant, twin):
        led(each, 5, begin=40)
    np.testing.assert_array_equal(plant.rows[others], twin.rows[others])
    np.testing.assert_array_equal(plant.windings.square[others], twin.windings.square[others])
    assert (plant.q[1] != twin.q[1]).any()


def test_drives_close_their_brakes_in_a_long_wait():
    plant = exact(2)
    led(plant, 40)
    for _ in range(30):
        plant.wait(0)
    assert plant.braked.tolist() == [True, False]
    assert np.abs(plant.qd[0]).max() < 0.01


def test_a_restored_plant_waits_as_the_saved_one():
    """Gains and current of the newest command are those of the wait, too."""
    soft = command(np.tile(HOME, (1, 1)), current=0.7)
    soft = soft._replace(drive=soft.drive._replace(kp=0.2 * soft.drive.kp))
    one, other = exact(1), exact(1)
    for _ in range(20):
        one.step(soft)
    other.restore(one.save())
    for plant in (one, other):
        for _ in range(4):
            plant.wait(0)
    np.testing.assert_array_equal(one.rows, other.rows)


def test_packets_after_a_wait_are_as_old_as_before():
    """A packet's stamp is the runtime's time less its true age: here the joint moved on while the clock stood still."""
    policy = Saying(2)
    policy.action[:] = 0.5
    runtime = running(2, policy=policy)
    for _ in range(60):
        runtime.tick()
    robot = runtime.robot
    truth = [robot.truth().q[0].copy()]
    for period in range(LATE):
        robot._wait(0, 1)
        truth.append(robot.truth().q[0].copy())
        place = (int(robot.sensors.tick[0]) - np.arange(period + 2)) % len(robot.sensors.ring[0])
        kept = robot.sensors.ring[0][place][:, robot.sensors.columns["encoder"]]
        np.testing.assert_allclose(kept, truth[::-1], atol=0.01)  # newest first
    assert np.abs(truth[-1] - truth[0]).max() > 0.01


def test_a_late_tick_is_the_next_one_of_the_runtime():
    """The setpoint goes on where it was: what the drives get has no jump."""
    policy = Saying(2)
    policy.action[:] = 0.5
    runtime, twin = (running(2, policy=policy) for _ in range(2))
    for each in (runtime, twin):
        for _ in range(40):
            each.tick()
    runtime.robot.plant.late[0] = LATE
    for each in (runtime, twin):
        each.tick()
    assert not runtime.robot.plant.late.any()
    np.testing.assert_array_equal(runtime.command.q, twin.command.q)
    assert (runtime.robot.truth().q[0] != twin.robot.truth().q[0]).any()
    np.testing.assert_array_equal(runtime.robot.truth().q[1], twin.robot.truth().q[1])


def test_noise_of_a_wait_is_its_own_and_repeats():
    sensors = running(2).robot.sensors
    noise = sensors.noise_of_wait(0, 4)
    np.testing.assert_array_equal(noise, sensors.noise_of_wait(0, 4))
    assert len(np.unique(noise[:, sensors.columns["encoder"]])) == 4 * SPEC.n
    assert (noise != sensors.noise_of_wait(1, 4)).all()
    encoder = noise[:, sensors.columns["encoder"]]
    assert 0.0002 < np.std(encoder) < 0.003
    assert encoder.shape == (4, N)
