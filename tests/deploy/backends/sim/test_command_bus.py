"""Commands that are lost, late or ignored, and drives that close their brakes by themselves."""

import numpy as np
import pytest

from support.arm6 import SPEC
from support.deploy.plants import DT, HOME, N, command, exact

bus_module = pytest.importorskip("deploy.backends.sim.command_bus")
CommandBus, WATCHDOG = bus_module.CommandBus, round(bus_module.WATCHDOG_S / DT)


def told(bus, tick, robots=2, **how):
    """The command that drives receive in a tick in which every joint is sent to `tick` rad."""
    return bus.deliver(command(np.full((robots, N), float(tick)), **how), tick)


def test_a_healthy_bus_hands_on_the_very_command():
    bus = CommandBus(SPEC, 2)
    for tick in range(100):
        sent = command(np.full((2, N), float(tick)), powered=tick % 7 > 2)
        assert bus.deliver(sent, tick) is sent


@pytest.mark.parametrize("lost", [1, 5, WATCHDOG])
def test_drives_keep_the_last_command_while_others_are_lost(lost):
    bus, heard = CommandBus(SPEC, 2), []
    for tick in range(60):
        bus.lost[0] = 20 <= tick < 20 + lost
        heard.append(told(bus, tick, qd=tick, tau=-tick, current=1.0 / (1 + tick)))
    q = np.array([each.q for each in heard])
    expected = np.where((np.arange(60) >= 20) & (np.arange(60) < 20 + lost), 19, np.arange(60))
    np.testing.assert_array_equal(q[:, 0], np.repeat(expected[:, None], N, axis=1))
    np.testing.assert_array_equal(q[:, 1, 0], np.arange(60))
    during = heard[20]
    assert (during.qd[0] == 19).all()
    assert (during.tau[0] == -19).all()
    assert (during.current_share[0] == 0.05).all()
    np.testing.assert_array_equal(during.drive.kp, heard[0].drive.kp)
    assert all(each.powered.all() for each in heard)


def test_late_commands_are_those_of_so_many_ticks_before():
    bus = CommandBus(SPEC, 2)
    for tick in range(60):
        bus.late[:] = [10 if tick >= 30 else 0, 5 if tick % 5 == 0 and tick >= 30 else 0]
        q = told(bus, tick).q[:, 0].tolist()
        if tick >= 30:
            assert q == [tick - 10, tick - 5 if tick % 5 == 0 else tick]


def test_a_drive_without_commands_closes_its_brakes_until_power_is_given_anew():
    bus, powered = CommandBus(SPEC, 1), []
    told(bus, 0, robots=1)
    for tick in range(1, 80):
        bus.lost[0] = tick < 40
        powered.append(bool(told(bus, tick, robots=1).powered[0]))
    assert powered == [True] * WATCHDOG + [False] * (79 - WATCHDOG)
    assert not told(bus, 80, robots=1, powered=False).powered[0]
    assert told(bus, 81, robots=1).powered[0]


def test_power_is_cut_by_a_wire_of_its_own_and_needs_a_command_to_come_back():
    bus = CommandBus(SPEC, 1)
    told(bus, 0, robots=1)
    bus.lost[0] = True
    assert told(bus, 1, robots=1).powered[0]
    assert not told(bus, 2, robots=1, powered=False).powered[0]
    assert not told(bus, 3, robots=1).powered[0]
    bus.lost[0] = False
    assert told(bus, 4, robots=1).powered[0]


def test_a_controller_that_is_down_closes_the_brakes_at_once_and_waits_for_power():
    bus = CommandBus(SPEC, 2)
    told(bus, 0)
    bus.down[0] = True
    assert told(bus, 1).powered.tolist() == [False, True]
    bus.down[0] = False
    assert told(bus, 2).powered.tolist() == [False, True]
    told(bus, 3, powered=np.array([False, True]))
    assert told(bus, 4).powered.all()


def test_a_plant_holds_the_last_setpoint_of_a_lost_burst():
    """The motor is led at 0.4 rad/s and stays behind by what was lost; the other robot follows."""
    plant = exact(2)
    for k in range(60):
        plant.bus.lost[0] = k >= 50
        plant.step(command(np.tile(HOME + 0.4 * k * DT, (2, 1)), 0.4))
    held = plant.drives.command.reshape(2, N, 3)[:, :, 0] / plant.drives.gear
    np.testing.assert_allclose(held[0], HOME + 0.4 * 49 * DT, atol=1e-12)
    np.testing.assert_allclose(held[1], HOME + 0.4 * 59 * DT, atol=1e-12)
    assert plant.braked.tolist() == [False, False]
    for k in range(60, 80):
        plant.step(command(np.tile(HOME + 0.4 * k * DT, (2, 1)), 0.4))
    assert plant.braked.tolist() == [True, False]


def test_a_bus_is_saved_with_its_robot():
    one, other = CommandBus(SPEC, 1), CommandBus(SPEC, 1)
    for tick in range(15):
        one.lost[0], one.late[0] = tick >= 10, 3
        told(one, tick, robots=1)
    other.restore(one.save())
    for tick in range(15, 40):
        a, b = told(one, tick, robots=1), told(other, tick, robots=1)
        np.testing.assert_array_equal(a.q, b.q)
        np.testing.assert_array_equal(a.powered, b.powered)
