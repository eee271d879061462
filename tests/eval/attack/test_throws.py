"""Predicted throws, compared with MuJoCo's inertias and Jacobians of the arm's own model."""

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from scipy.stats import qmc

from eval.attack.loaded_robots import LIVES
from eval.attack.throws import POSES, throws
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.models.nominal_model import torque_max
from robots.motors.drive_gains import drive_gains
from support.arm6 import SPEC

FORCE, PLAY, WORN = 20.0, 4e-4, 3e-4
N = SPEC.n


def arms(mass=1.0, centre=0.0):
    """One arm of the middle of draws.toml, with links so many times as heavy, and the push and play of this module."""
    middle = median_draw(load_distributions(SPEC), SPEC, 1)
    return middle.replaced(
        {
            "push.force_n": FORCE,
            "joints.backlash_rad": PLAY,
            "wear.backlash_rad": WORN,
            "links.mass": mass,
            "links.com_m": centre,
        }
    )


def oracle():
    """Yield levers (n, n) of centres of mass about joints and inertias (n,) without rotors, in the same poses."""
    model = mujoco.MjModel.from_xml_path(str(SPEC.folder / "model.xml"))
    data, (low, high) = mujoco.MjData(model), SPEC.pose_range
    bodies = model.jnt_bodyid[:N]
    for place in qmc.Halton(N, scramble=False).random(POSES):
        data.qpos[:N] = low + place * (high - low)
        mujoco.mj_forward(model, data)
        levers, jacobian, full = np.zeros((N, N)), np.zeros((3, model.nv)), np.zeros((model.nv, model.nv))
        for link, body in enumerate(bodies):
            mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
            levers[:, link] = np.linalg.norm(jacobian[:, :N], axis=0)
        mujoco.mj_fullM(model, data, full)
        yield levers, np.diagonal(full)[:N] - model.dof_armature[:N]


def test_speed_is_that_of_a_link_at_the_end_of_its_play():
    work = 2.0 * FORCE * (PLAY + LIVES * WORN)
    expected = np.max([np.sqrt(work * levers / inertia[:, None]) for levers, inertia in oracle()], axis=0)
    found = throws(SPEC, arms()).speed[0] * SPEC.joint_array("qd_max")[:, None]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


def test_tool_is_what_throws_of_all_links_add_up_to():
    work = 2.0 * FORCE * (PLAY + LIVES * WORN)
    sums = [np.sum(np.sqrt(work * levers[:, -1] ** 3 / inertia)) for levers, inertia in oracle()]
    np.testing.assert_allclose(throws(SPEC, arms()).tool, max(sums), rtol=1e-6)


def test_torque_is_the_damping_of_link_and_rotor_together():
    armature, work = np.array([1.0201] * 3 + [0.20402] * 3), 2.0 * FORCE * (PLAY + LIVES * WORN)
    blows = [
        np.sqrt(work * levers / inertia[:, None]) * (inertia / (inertia + armature))[:, None]
        for levers, inertia in oracle()
    ]
    share = drive_gains(SPEC).kd / torque_max(SPEC)
    np.testing.assert_allclose(
        throws(SPEC, arms()).torque[0], share[:, None] * np.max(blows, axis=0), rtol=1e-6, atol=1e-6
    )


def test_a_push_before_a_joint_does_not_move_it_and_heavy_links_are_slower():
    light, heavy = (throws(SPEC, arms(mass=mass)).speed[0] for mass in (1.0, 4.0))
    assert (light[np.tril_indices(N, -1)] < 1e-9).all()
    assert (light[np.triu_indices(N - 1)] > 0.0).all()
    np.testing.assert_allclose(light, 2.0 * heavy, atol=1e-9)


def test_a_centre_off_the_axis_of_the_last_joint_is_thrown_about_it():
    """The nominal centre of arm6's last link is on its axis, where no push turns it."""
    assert throws(SPEC, arms()).speed[0, -1, -1] < 1e-6
    assert throws(SPEC, arms(centre=np.array([0.005, 0.0, 0.0]))).speed[0, -1, -1] > 0.1
