"""Simulations that MuJoCo cannot go on with."""

import shutil

import numpy as np
import pytest

from robots.errors import RobotError
from robots.spec import ROBOTS, load_robot
from support.arm6 import copy_of_arm
from support.deploy.plants import HOME, command, drawn, exact

pytest.importorskip("mujoco")


def cramped(folder, monkeypatch, kib):
    """Two robots with little memory for contacts and the solver, the second folded into itself."""
    monkeypatch.setattr("robots.models.mujoco_model.WORKING_MEMORY", 0)
    small = [("<option timestep", rf'<size memory="{kib}K"/>\g<0>')]
    plant, folded = exact(2, spec=load_robot(copy_of_arm(folder, xml=small))), HOME.copy()
    folded[2], folded[3] = 3.0, 1.0
    plant.reset(np.array([False, True]), np.tile(folded, (2, 1)))
    return plant


def test_any_mujoco_warning_invalidates_the_simulation(tmp_path, monkeypatch):
    """It stops in the middle of a rollout, so it lives less than the others: here for want of room for contacts."""
    monkeypatch.chdir(tmp_path)
    plant = cramped(tmp_path, monkeypatch, 12)
    plant.step(command(plant.q.copy()))
    assert plant.truth(0.0).valid.tolist() == [True, False]
    assert not list(tmp_path.glob("*.TXT"))  # nor does MuJoCo leave a log where the user is


@pytest.mark.parametrize(("kib", "lost"), [(9, 0), (18, 1)])
def test_a_simulation_without_room_for_the_solver_is_invalid(tmp_path, monkeypatch, kib, lost):
    """In a step, or already in the pose that it is placed in."""
    plant = cramped(tmp_path, monkeypatch, kib)
    assert plant.valid.tolist() == [True, lost != 1]
    plant.step(command(plant.q.copy()))
    assert not plant.truth(0.0).valid[lost]
    assert "mj_stackAlloc: out of memory" in plant.batch.error(lost)


def test_a_robot_that_has_no_room_to_start_is_refused(tmp_path):
    """The plant gives every contact friction, so it needs more room than the model alone."""
    folder = shutil.copytree(ROBOTS / "planar3", tmp_path / "planar3")
    path, text = folder / "model.xml", (folder / "model.xml").read_text()
    near = '<geom type="sphere" pos="0.1 0 {}" size="0.02" margin="2" mass="0"/>'
    many = "".join(near.format(0.0001 * place) for place in range(80))
    for link in (1, 3):
        text = text.replace(f'<geom name="segment_{link}"', many + f'<geom name="segment_{link}"')
    path.write_text(text)
    with pytest.raises(
        RobotError,
        match=r"planar3/model\.xml: MuJoCo cannot simulate it: mj_stackAlloc: out of memory, .*\d$",
    ):
        exact(spec=load_robot(folder))


@pytest.mark.parametrize("how", ["speed", "nan"])
def test_a_diverged_simulation_is_seen_and_stays_seen(how):
    plant, twin = drawn(3), drawn(3)
    still = command(np.tile(HOME, (3, 1)))
    plant.batch.bind("qvel")[1] = 1e200 if how == "speed" else np.nan
    for _ in range(220):
        plant.step(still)
        twin.step(still)
        assert plant.truth(0.0).valid.tolist() == [True, False, True]
    np.testing.assert_array_equal(plant.rows[[0, 2]], twin.rows[[0, 2]])
    assert np.isfinite(plant.housing).all()
    assert np.isfinite(plant.wear.life).all()
    plant.reset(np.array([False, True, False]), np.tile(HOME, (3, 1)))
    for _ in range(220):
        plant.step(still)
    assert plant.truth(0.0).valid.all()
    assert np.abs(plant.q[1] - HOME).max() < 0.05
