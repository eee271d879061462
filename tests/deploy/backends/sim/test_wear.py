import numpy as np
import pytest

from robots.distributions import load_distributions
from support.arm6 import SPEC
from support.deploy.plants import DT, HOME, PLANT_MODEL, N, command, drawn, exact

pytest.importorskip("mujoco")
WEAR = load_distributions(SPEC).wear
WORN = {
    "wear.friction": 0.5,
    "wear.backlash_rad": 0.001,
    "wear.encoder_rad": -0.002,
    "wear.torque_constant": -0.1,
    "joints.backlash_rad": 0.0004,
}


def test_wear_is_travel_doubled_for_each_10_k():
    plant, travel = exact(2), np.linspace(0.0, 500.0, 2 * N).reshape(2, N)
    winding = WEAR.life_c + np.array([[0.0, 10.0, -10.0, 20.0, 5.0, -30.0]] * 2)
    plant.wear.step(travel, winding)
    np.testing.assert_allclose(
        plant.wear.life, travel / WEAR.life_rad * [1.0, 2.0, 0.5, 4.0, np.sqrt(2.0), 0.125], rtol=1e-12
    )
    once = plant.wear.life.copy()
    plant.wear.step(travel, winding)
    np.testing.assert_allclose(plant.wear.life, 2.0 * once)


def test_worn_parameters_grow_in_proportion_to_the_wear():
    plant, new = exact(1, WORN), exact(1, WORN).batch.get_model(0)
    plant.wear.life[:] = np.linspace(0.0, 2.0, N)
    plant.wear.apply()
    own, life = plant.batch.get_model(0), plant.wear.life[0]
    np.testing.assert_allclose(
        own.dof_frictionloss[PLANT_MODEL.dofs], new.dof_frictionloss[PLANT_MODEL.dofs] * (1.0 + 0.5 * life)
    )
    play = 0.0004 + 0.001 * life
    np.testing.assert_allclose(own.jnt_range[PLANT_MODEL.backlash], np.stack((-play / 2, play / 2), axis=1))
    np.testing.assert_allclose(own.actuator_gainprm[:, 1], new.actuator_gainprm[:, 1] * (1.0 - 0.1 * life))
    worn = plant.wear.worn()
    np.testing.assert_allclose(worn.friction[0], 1.0 + 0.5 * life)
    np.testing.assert_allclose(worn.backlash_rad[0], play)
    np.testing.assert_allclose(worn.encoder_rad[0], -0.002 * life)
    np.testing.assert_allclose(worn.torque_constant[0], 1.0 - 0.1 * life)


def test_worn_torque_constant_stays_positive():
    plant = exact(1, {"wear.torque_constant": -0.9})
    plant.wear.life[:] = 50.0
    plant.wear.apply()
    assert (plant.wear.worn().torque_constant == 0.05).all()
    assert (plant.batch.get_model(0).actuator_gainprm[:, 1] > 0).all()


def test_worn_parameters_stay_physical():
    """Here one hot second of the shortest life at the coldest."""
    worst = {"wear.friction": 20.0, "wear.backlash_rad": 0.05, "wear.encoder_rad": np.repeat([-0.1, 0.1], 3)}
    plant = exact(1, worst)
    plant.wear.life[:] = 3.0 / 1.0 * 2.0 ** ((300.0 + 50.0) / 10.0)
    plant.wear.apply()
    worn = plant.wear.worn()
    np.testing.assert_array_equal(worn.friction, 20.0)
    np.testing.assert_array_equal(worn.backlash_rad, 0.05)
    np.testing.assert_array_equal(worn.encoder_rad[0], [-0.1] * 3 + [0.1] * 3)
    assert np.abs(plant.batch.get_model(0).jnt_range[PLANT_MODEL.backlash]).max() == 0.025


def test_slipped_encoder_reads_with_an_offset():
    plant = exact(1, WORN)
    plant.wear.life[:] = 1.5
    plant.wear.apply()
    plant.step(command(HOME))
    np.testing.assert_allclose(plant.readings["encoder"] - plant.kinematics.motor_q, -0.003, rtol=1e-9)


def test_current_follows_the_worn_torque_constant():
    """A weaker magnet needs more of it for the same torque."""
    plants = [exact(1, {"wear.torque_constant": -0.2}) for _ in range(2)]
    plants[1].wear.life[:] = 1.0
    plants[1].wear.apply()
    for plant in plants:
        for _ in range(200):
            plant.step(command(HOME))
    new, worn = (plant.readings["current"][0, 1] for plant in plants)
    torques = [plant.truth(0.0).tau[0, 1] for plant in plants]
    assert abs(new) > 0.1
    assert torques[1] == pytest.approx(torques[0], rel=1e-3)
    assert worn == pytest.approx(new / 0.8, rel=1e-3)


def test_joints_wear_by_their_travel():
    """One joint to and fro for three seconds at a known speed; the others stand still and stay new."""
    plant, qd = exact(1), np.zeros(N)
    q, way = HOME.copy(), 0.0
    for k in range(600):
        qd[0] = 0.6 * np.sin(2 * np.pi * k * DT)
        q += qd * DT
        way += abs(qd[0]) * DT
        plant.step(command(q, qd))
    hastened = 2.0 ** ((plant.truth(0.0).winding_c[0, 0] - WEAR.life_c) / 10.0)
    assert plant.wear.life[0, 0] == pytest.approx(way / WEAR.life_rad * hastened, rel=0.02)
    assert (plant.wear.life[0, 3:] < 0.01 * plant.wear.life[0, 0]).all()


def test_restored_wear_is_bit_identical():
    old, new = drawn(3), drawn(3)
    rng = np.random.default_rng(0)
    old.wear.step(rng.uniform(0, 5000, (3, N)), rng.uniform(20, 100, (3, N)))
    new.restore(old.save())
    for name in ("dof_frictionloss", "jnt_range", "actuator_gainprm"):
        np.testing.assert_array_equal(new.batch.expand(name), old.batch.expand(name))
    for one, other in zip(old.wear.worn(), new.wear.worn(), strict=True):
        np.testing.assert_array_equal(one, other)
