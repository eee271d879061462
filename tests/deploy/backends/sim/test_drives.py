import numpy as np
import pytest

from robots.tables import Rates
from support.arm6 import SPEC
from support.deploy.plants import DT, HOME, PLANT_MODEL, N, command, exact

pytest.importorskip("mujoco")
Drives = pytest.importorskip("deploy.backends.sim.drives").Drives


def followed(delay_s, rates=SPEC.rates, periods=40):
    """(periods x substeps,) what drive 0 follows when it is led along the parabola q = t²: points, then the course."""
    spec = SPEC.model_copy(update={"rates": rates})
    drives = exact(1, {"drives.delay_s": delay_s}, spec=spec).drives
    drives.rest(np.arange(1), np.zeros((1, N)))
    points = (np.arange(1, periods + 1) / rates.control_hz) ** 2
    course = [drives.step(command(np.full((1, N), q)), *np.zeros((2, 1, N)))[0, :, 0].copy() for q in points]
    return points, np.concatenate(course) / drives.gear[0, 0]


@pytest.mark.parametrize("rates", [(200, 1000), (500, 1000), (1000, 1000), (50, 1000)])
@pytest.mark.parametrize("delay_s", [0.0, 0.001, 0.0026, 0.005])
def test_commands_are_delayed_by_whole_substeps_and_interpolated(delay_s, rates):
    """The course is that of straight lines between commands, as it was `delay_s` ago to the nearest substep."""
    rates = Rates(control_hz=rates[0], physics_hz=rates[1])
    points, course = followed(delay_s, rates)
    t = (
        np.arange(1, len(course) + 1) / rates.physics_hz
        - round(delay_s * rates.physics_hz) / rates.physics_hz
    )
    when = np.arange(len(points) + 1) / rates.control_hz
    expected = np.interp(t, when, np.concatenate(([0.0], points)), left=0.0)
    np.testing.assert_allclose(course, expected, rtol=0, atol=1e-12)


def test_each_robot_has_a_bus_of_its_own():
    late = np.array([0.0, 0.002, 0.004])
    plant = exact(3, {"drives.delay_s": late})
    for k in range(100):
        plant.step(command(np.tile(HOME + 0.4 * k * DT, (3, 1)), 0.4))
    np.testing.assert_allclose(plant.q[0] - plant.q[1], 0.4 * 0.002, atol=2e-4)
    np.testing.assert_allclose(plant.q[0] - plant.q[2], 0.4 * 0.004, atol=2e-4)


def test_brakes_are_not_delayed_by_the_bus():
    """What is still under way to the drives when the brakes close never arrives."""
    plant = exact(1, {"drives.delay_s": 0.005})
    for k in range(40):
        plant.step(command(HOME + 0.4 * k * DT, 0.4))
    plant.brake(np.ones(1, dtype=bool))
    np.testing.assert_array_equal(plant.drives.history[0], np.tile(plant.drives.command[0], (10, 1)))
    control = plant.drives.step(command(HOME, powered=False), plant.kinematics.motor_q, np.zeros((1, N)))
    np.testing.assert_array_equal(control[0, :, ::3], np.tile(plant.drives.held * plant.drives.gear, (5, 1)))
    assert not control[0, :, 1::3].any()


def test_brakes_go_on_to_carry_the_load_that_the_drives_had():
    """Without feed-forward the lift sags by 0.5 mrad; when its brake closes, it stays there."""
    plant = exact(1)
    for _ in range(200):
        plant.step(command(HOME))
    before, lift = plant.kinematics.motor_q.copy(), 1
    assert abs(before[0, lift] - HOME[lift]) > 4e-4
    for _ in range(100):
        plant.step(command(HOME, powered=False))
    np.testing.assert_allclose(plant.kinematics.motor_q, before, atol=2e-5)
    assert not plant.current.any()


def test_a_drive_follows_its_slipped_encoder():
    """It reads 0.2 rad more from one moment on, and turns the joint back by that: the reading is as it was."""
    plant = exact(2)
    for _ in range(20):
        plant.step(command(np.tile(HOME, (2, 1))))
    plant.drives.slip_encoder(0, 2, 0.2)
    course = [plant.readings["encoder"][:, 2].copy()]
    for _ in range(200):
        plant.step(command(np.tile(HOME, (2, 1))))
        course.append(plant.readings["encoder"][:, 2].copy())
    assert plant.q[0, 2] == pytest.approx(HOME[2] - 0.2, abs=0.01)
    assert course[1][0] - HOME[2] > 0.15
    assert course[-1][0] == pytest.approx(HOME[2], abs=0.01)
    np.testing.assert_allclose(plant.q[1], HOME, atol=0.01)
    plant.drives.slip_encoder(0, 2, 0.0)
    for _ in range(200):
        plant.step(command(np.tile(HOME, (2, 1))))
    np.testing.assert_allclose(plant.q, np.tile(HOME, (2, 1)), atol=0.01)


def test_brakes_hold_the_shaft_and_not_the_encoder():
    plant = exact(1)
    for _ in range(20):
        plant.step(command(HOME))
    for slip in (0.2, 0.0):
        plant.drives.slip_encoder(0, 2, slip)
        for _ in range(40):
            plant.step(command(HOME, powered=False))
        assert plant.q[0, 2] == pytest.approx(HOME[2], abs=0.005)
        assert plant.readings["encoder"][0, 2] == pytest.approx(HOME[2] + slip, abs=0.005)


def sink(plant, current, qd):
    """Cold windings draw."""
    plant.supply.update(current, qd, plant.wear.constant, plant.windings.ohm(25.0))


def volts(current, qd, ohm):
    """Of each drive of one robot, when all carry `current` A and turn at `qd` rad/s."""
    plant = exact(1, {"drives.supply_ohm": ohm})
    sink(plant, np.full((1, N), current), np.full((1, N), qd))
    return plant.supply.limit[0]


def test_the_bus_settles_where_the_power_drawn_is_the_power_delivered():
    """V = V0 - R P / V with P of all motors, u I; no drive has a voltage of its own."""
    found = volts(2.0, 1.5, 0.3)
    model = PLANT_MODEL.model
    resistance, constant = model.actuator_gainprm[:, 0], model.actuator_gainprm[:, 1]
    power = (2.0 * (resistance * 2.0 + constant * 101 * 1.5)).sum()
    assert power > 200.0
    np.testing.assert_allclose(found, 48.0 - 0.3 * power / found, rtol=1e-12)
    assert len(set(found)) == 1


def test_braking_drives_do_not_lift_the_bus_and_overload_halves_it():
    np.testing.assert_array_equal(volts(-5.0, 2.0, 0.3), 48.0)
    np.testing.assert_array_equal(volts(15.0, 3.0, 5.0), 24.0)


def test_hot_windings_draw_more_power():
    """R I² with R(T) = R0 (1 + α (T - T0)), as the motors have it."""
    cold, hot = (
        exact(1, {"drives.supply_ohm": 1.0, "climate.ambient_c": ambient}) for ambient in (25.0, 75.0)
    )
    drawn = []
    for plant in (cold, hot):
        for _ in range(40):
            plant.step(command(HOME))
        own = plant.batch.get_model(0)
        cold_ohm = PLANT_MODEL.model.actuator_gainprm[:, 0]
        resistance = cold_ohm * (1.0 + 0.0039 * (plant.truth(0.0).winding_c[0] - 25.0))
        motor = (
            plant.current[0] * resistance + own.actuator_gainprm[:, 1] * 101 * plant.kinematics.motor_qd[0]
        )
        drawn.append((motor * plant.current[0]).sum())
        bus = plant.supply.limit[0, 0]
        assert bus * (48.0 - bus) == pytest.approx(drawn[-1], rel=1e-9)
    assert drawn[1] > 1.15 * drawn[0] > 0.5


def test_a_bus_is_saved_and_reset_with_its_robot():
    plant, other = (exact(2, {"drives.supply_ohm": 1.0}) for _ in range(2))
    sink(plant, np.full((2, N), 3.0), np.ones((2, N)))
    other.restore(plant.save())
    np.testing.assert_array_equal(other.supply.limit, plant.supply.limit)
    other.reset(np.array([False, True]), np.tile(HOME, (2, 1)))
    assert (other.supply.limit[0] < 47.0).all()
    np.testing.assert_array_equal(other.supply.limit[1], 48.0)


def test_low_bus_voltage_reduces_speed():
    """A supply behind 5 ohm cannot follow what a stiff one can."""
    plants = [exact(1, {"drives.supply_ohm": ohm, "drives.voltage": 0.75}) for ohm in (0.0, 5.0)]
    worst, lowest = [], []
    for plant in plants:
        q, qd, error, limit = HOME.copy(), 0.0, 0.0, np.inf
        for k in range(120):
            qd = 3.0 * min(1.0, k * DT / 0.3)
            q[0] += qd * DT
            plant.step(command(q, np.array([qd, 0, 0, 0, 0, 0])))
            error, limit = max(error, abs(plant.q[0, 0] - q[0])), min(limit, plant.supply.limit[0, 0])
        worst.append(error)
        lowest.append(limit)
    assert worst[0] < 0.01
    assert worst[1] > 0.02
    assert lowest[1] < lowest[0] == 36.0


def test_low_supply_voltage_matters_only_at_speed():
    """A drive that holds still needs a volt; at full speed its back-EMF needs 32."""
    rest = [exact(1, {"drives.voltage": factor}) for factor in (1.0, 0.6)]
    for plant in rest:
        for _ in range(60):
            plant.step(command(HOME))
    np.testing.assert_array_equal(rest[0].q, rest[1].q)
