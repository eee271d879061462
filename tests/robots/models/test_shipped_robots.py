"""Claims that hold for every robot in robots/: complete folders, one model in both libraries, drives that suffice."""

import numpy as np
import pinocchio as pin
import pytest

from deploy.tasks.task import tasks_of
from eval.judge.limits import load_limits
from robots.distributions import load_distributions
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.windings import nominal_windings
from robots.spec import ROBOTS, load_robot

mujoco = pytest.importorskip("mujoco")
load_mujoco = pytest.importorskip("robots.models.mujoco_model").load_mujoco
VOLTAGE_MAX = pytest.importorskip("deploy.backends.sim.model.motor_parameters").VOLTAGE_MAX

NAMES = sorted(path.parent.name for path in ROBOTS.glob("*/robot.toml"))
MOUNTED = [name for name in NAMES if load_robot(name).base is None]
FILES = {"README.md", "model.xml", "robot.toml", "draws.toml", "limits.toml"}


@pytest.fixture(scope="module", params=NAMES)
def spec(request):
    return load_robot(request.param)


def states(spec, count, seed=0):
    """Angles over the whole turn, and speeds."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-np.pi, np.pi, (count, spec.n)), rng.uniform(-4, 4, (count, spec.n))


def test_every_kind_of_robot_is_shipped():
    assert {"arm6", "planar3", "planar4", "quadruped"} <= set(NAMES)


def test_folder_has_the_files_of_every_robot(spec):
    assert {path.name for path in spec.folder.iterdir()} == FILES
    assert (spec.folder / "README.md").read_text(encoding="utf-8").startswith(f"# {spec.name}\n")
    assert spec.name == spec.folder.name


def test_files_beside_the_specification_fit_it(spec):
    assert load_distributions(spec).links.mass.low < 1 < load_distributions(spec).links.mass.high
    assert load_limits(spec).motors.keys() == spec.motors.keys()


def test_a_task_fits(spec):
    assert tasks_of(spec)


def test_kinematics_and_dynamics_agree(spec):
    """Of a robot with a floating base, with the base at rest in the origin: the nominal model has none."""
    model, (arm, _) = load_mujoco(spec), load_pinocchio(spec)
    data, arm_data, worst, n = mujoco.MjData(model), arm.createData(), 0.0, spec.n
    dense, joints = np.zeros((model.nv, model.nv)), slice(model.nv - n, None)
    data.qpos[: model.nq - n] = (0, 0, 0, 1, 0, 0, 0)[: model.nq - n]
    sites = [
        (model.site(name).id, arm.getFrameId(name)) for name in (spec.base.feet if spec.base else [spec.tool])
    ]
    for q, qd in zip(*states(spec, 500), strict=True):
        data.qpos[-n:], data.qvel[joints] = q, qd
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        upper = np.triu(pin.crba(arm, arm_data, q))
        pin.framesForwardKinematics(arm, arm_data, q)
        bias = pin.nonLinearEffects(arm, arm_data, q, qd)
        mass = upper + np.triu(upper, 1).T
        worst = max(
            worst, np.abs(dense[joints, joints] - mass).max(), np.abs(data.qfrc_bias[joints] - bias).max()
        )
        for site, frame in sites:
            placement, rotation = arm_data.oMf[frame], data.site_xmat[site].reshape(3, 3)
            worst = max(worst, np.abs(data.site_xpos[site] - placement.translation).max())
            worst = max(worst, np.abs(rotation - placement.rotation).max())
    assert worst <= 1e-10


def test_working_range_lies_inside_the_mechanical_one(spec):
    model = load_mujoco(spec)
    low, high = model.jnt_range[-spec.n :].T
    assert (spec.joint_array("q_min") > low).all()
    assert (spec.joint_array("q_max") < high).all()
    np.testing.assert_array_equal(torque_max(spec), model.jnt_actfrcrange[-spec.n :, 1])


@pytest.mark.parametrize("name", MOUNTED)
def test_nominal_motion_within_its_limits_needs_at_most_the_share_of_the_torque_that_is_allowed(name):
    """99 of 100 states at any speed and acceleration; the others are refused, one by one.

    Drives of legs act as springs that saturate: no setpoint of theirs is refused for its torque.
    """
    spec = load_robot(name)
    rng, count = np.random.default_rng(1), 4000
    q = rng.uniform(spec.joint_array("q_min"), spec.joint_array("q_max"), (count, spec.n))
    qd = rng.uniform(-1, 1, q.shape) * spec.margins.speed * spec.joint_array("qd_max")
    qdd = rng.uniform(-1, 1, q.shape) * spec.joint_array("qdd_max")
    share = np.abs(Fleet(spec, count).torque(q, qd, qdd)) / torque_max(spec)
    assert (share <= spec.margins.tau).all(axis=1).mean() > 0.99


def test_drives_reach_their_torque_at_full_speed(spec):
    """On the nominal supply, with cold windings."""
    model, windings = load_mujoco(spec), nominal_windings(spec)
    back_emf = windings.constant * spec.joint_array("qd_max")
    volts = back_emf + torque_max(spec) / windings.constant * windings.resistance
    assert (volts < model.actuator_gainprm[:, VOLTAGE_MAX]).all()
