"""A robot that somebody else made: the Franka Panda as robosuite ships it, where that is installed."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("tomlkit")

import mujoco
import tomlkit

from deploy.state import Mode
from policies.robot_init.cli import init_robot
from robots.models.fleet import Fleet
from robots.models.mujoco_model import load_mujoco
from robots.models.nominal_model import load_pinocchio, torque_max
from support.robot_init import ANSWERS, fill_in, hold

PACKAGE = find_spec("robosuite")
pytestmark = pytest.mark.skipif(PACKAGE is None, reason="robosuite, which ships the Panda, is not installed")

FER = {
    "q_home": [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785],
    "qd_max": [2.175] * 4 + [2.61] * 3,
    "qdd_max": [7.5, 3.75, 5.0, 6.25, 7.5, 10.0, 10.0],
    "qddd_max": [375.0, 187.5, 250.0, 312.5, 375.0, 500.0, 500.0],
    "source": ["Franka FER: speeds; half of its accelerations and a twentieth of its jerks"] * 7,
    "motor": ["motor1"] * 4 + ["motor2"] * 3,
}
"""Source: Franka Control Interface documentation, limits of the FER."""
TORQUE = {"motor1": 87.0, "motor2": 12.0}


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    """robosuite's model, unchanged, with what its makers publish and estimates of its drives."""
    out = tmp_path_factory.mktemp("robots") / "panda"
    model = Path(PACKAGE.submodule_search_locations[0], "models", "assets", "robots", "panda", "robot.xml")
    init_robot(model, out)
    document = tomlkit.parse((out / "robot.toml").read_text())
    for i, joint in enumerate(document["joints"]):
        joint.update({key: values[i] for key, values in FER.items()})
    for name, torque in TORQUE.items():
        document["motors"][name]["drive"]["torque_max"] = torque
    (out / "robot.toml").write_text(tomlkit.dumps(document))
    return fill_in(out, ANSWERS | {"gear": 100.0})


def test_both_libraries_have_the_same_panda(panda):
    model, (arm, _) = load_mujoco(panda), load_pinocchio(panda)
    data, arm_data, rng, dense = (
        mujoco.MjData(model),
        arm.createData(),
        np.random.default_rng(0),
        np.zeros((7, 7)),
    )
    assert panda.joint_names == tuple(f"joint{i}" for i in range(1, 8))
    np.testing.assert_array_equal(torque_max(panda), [87.0] * 4 + [12.0] * 3)
    for _ in range(50):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, (2, 7))
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        mass = pin.crba(arm, arm_data, data.qpos)
        np.testing.assert_allclose(np.triu(mass) + np.triu(mass, 1).T, dense, atol=1e-10)
        np.testing.assert_allclose(
            pin.nonLinearEffects(arm, arm_data, data.qpos, data.qvel), data.qfrc_bias, atol=1e-10
        )


def test_capsules_are_found_where_the_panda_folds_onto_itself(panda):
    fleet, home = Fleet(panda, 2, collisions=True), panda.joint_array("q_home")
    folded = home.copy()
    folded[[1, 3, 5]] = -1.6, -3.0, 0.1
    kinematics = fleet.kinematics(np.stack((home, folded)))
    np.testing.assert_array_equal(kinematics.colliding, [False, True])


def test_a_panda_holds_its_home_through_the_whole_runtime(panda):
    runtime, worst = hold(panda, 5.0)
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    assert worst < 0.01
