import numpy as np
import pytest

from robots.motors.motor import temperatures
from support.arm6 import SPEC
from support.deploy.plants import DT, HOME, N, command, exact
from support.robots.motors import RE40

pytest.importorskip("mujoco")
Housings = pytest.importorskip("deploy.backends.sim.heat").Housings
GEAR = 101.0
RWH = np.array([1.0] * 3 + [2.0] * 3)
RHA, CAPACITY = (SPEC.motor_array(f"housing_{name}") for name in ("resistance_k_per_w", "capacity_j_per_k"))


def test_a_turning_motor_without_current_warms_by_its_iron_alone():
    """Closed form of one node: P Rha (1 - exp(-t / Rha Ch)), windings as warm as their housings."""
    plant, qd, seconds = exact(1, {"drives.iron_loss": 1.5}), 2.5, 1800
    rise, still = np.zeros((1, N)), np.zeros((1, N))
    for _ in range(seconds):
        plant.housings.warm(rise, still, np.full((1, N), qd**2), 1.0)
        rise[:] = 0.0
    iron = 1.5 * SPEC.motor_array("iron_w_s2") * (GEAR * qd) ** 2
    expected = 25.0 + iron * RHA * (1.0 - np.exp(-seconds / (RHA * CAPACITY)))
    assert expected.min() > 26.0
    np.testing.assert_allclose(plant.housing[0], expected, atol=0.02)


def test_friction_and_damping_losses_warm_the_housing():
    """One joint at a steady speed: (F + D qd) qd; the windings' share, which is far less here, apart."""
    changes = {"joints.friction": 2.0, "joints.damping": 3.0, "drives.resistance": 0.05}
    plant, qd = exact(1, changes), np.array([1.0, 0, 0, 0, 0, 0])
    q = HOME.copy() - 1.5 * qd
    plant.reset(np.ones(1, dtype=bool), q[None])
    ramp = 0.0
    for k in range(600):
        speed = min(1.0, 2.0 * k * DT)
        q, ramp = q + speed * qd * DT, ramp + speed * DT
        plant.step(command(q, speed * qd))
    friction, damping = 2.0 * 3.0, 3.0 * 4.0
    turned = 2.5 + 0.5 / 3.0
    joules = friction * ramp + damping * turned
    warmed = plant.housing[0] - 25.0
    assert warmed[0] == pytest.approx(joules / CAPACITY[0], rel=0.05)
    assert (warmed[3:] < 0.05 * warmed[0]).all()


def test_housing_starts_at_the_drawn_temperature_and_cools_to_ambient():
    plant = exact(1, {"climate.ambient_c": 18.0, "climate.warm_start_k": 12.0})
    truth = plant.truth(0.0)
    np.testing.assert_array_equal(truth.housing_c, 30.0)
    np.testing.assert_array_equal(truth.winding_c, 30.0)
    np.testing.assert_array_equal(plant.readings["temperature"], 30.0)
    for _ in range(400):
        plant.step(command(HOME))
    idle = plant.truth(0.0).housing_c[0, 0]  # no load on the vertical axis
    expected = 18.0 + 12.0 * np.exp(-400 * DT / (1.5 * 1200.0))
    assert idle == pytest.approx(expected, abs=0.01)


def test_the_winding_keeps_its_temperature_when_its_housing_warms():
    """Energy: what leaves the winding enters the housing; the change of ambient itself heats nothing."""
    plant = exact()
    rise = np.full((1, N), 40.0)
    before = plant.housing + rise
    plant.housings.warm(rise, np.zeros((1, N)), np.zeros((1, N)), 1.0)
    np.testing.assert_allclose(plant.housing + rise, before, rtol=1e-14)
    np.testing.assert_allclose(plant.housing[0] - 25.0, 40.0 / RWH / CAPACITY)
    np.testing.assert_array_equal(plant.batch.expand("actuator_dynprm")[:, :, 4], plant.housing)


def test_published_course_of_an_re40_in_steps_of_a_second():
    """The table of `robots.motors.motor`, this housing and a winding: steps of a second make no difference."""
    winding, housing, dt = 25.0, 25.0, 0.05
    inner, outer = 1 / RE40.winding_to_housing, 1 / RE40.housing_to_ambient
    for k in range(round(600 / dt)):
        loss = 3.12**2 * RE40.resistance * (1 + RE40.alpha * (winding - 25.0))
        winding += dt / RE40.winding_capacity * (loss - (winding - housing) * inner)
        if k % 20 == 19:
            housing += 1.0 / RE40.housing_capacity * ((winding - housing) * inner - (housing - 25.0) * outer)
    assert (winding, housing) == pytest.approx(temperatures(RE40, 3.12, 25.0, 600.0), abs=0.2)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_saturated_motor_is_heated_by_its_limited_current(share):
    """Not by the one that its voltage would drive: that would be forty times the heat."""
    plant, tau, current = exact(1, {"joints.armature": 20.0}), np.zeros(N), np.ones(N)
    tau[5], current[5] = 1000.0, share
    for _ in range(40):
        plant.step(command(HOME, tau=tau, current=current))
    amperes = share * 28.0 / 101 / 0.1
    assert plant.current[0, 5] == pytest.approx(amperes, rel=0.01)
    rise = plant.truth(0.0).winding_c[0, 5] - plant.housing[0, 5]
    assert rise == pytest.approx(amperes**2 * 3.0 * 40 * DT / 12.0, rel=0.03)
