import numpy as np
import pytest

from deploy.policy.contract_action import ActionSpec
from deploy.policy.gain_bounds import GAIN_MARGIN, gain_misfits, stiffness_bounds
from robots.models.joint_inertia import joint_inertia
from robots.models.levers import joint_levers
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm
from support.planar import PLANAR4
from support.quadruped import QUADRUPED

N, OWN = SPEC.n, drive_gains(SPEC)


def misfits(spec, kp, kd, mode="position"):
    n = spec.n
    offset = (0.0,) * n if mode == "position" else None
    action = ActionSpec(
        mode=mode,
        size=n,
        offset=offset,
        scale=(1.0,) * n,
        clip=None,
        kp=tuple(np.broadcast_to(kp, n).tolist()),
        kd=tuple(np.broadcast_to(kd, n).tolist()),
    )
    return list(gain_misfits(action, spec))


@pytest.mark.parametrize("spec", [SPEC, PLANAR4, QUADRUPED], ids=lambda spec: spec.name)
def test_a_robot_bears_its_own_gains(spec):
    assert misfits(spec, *drive_gains(spec)) == []


@pytest.mark.parametrize("kp", [1e6, 1e308, 1e-6])
def test_stiffness_out_of_bounds_names_joint_value_and_bounds(kp):
    lines = misfits(SPEC, kp, OWN.kd)
    assert [line.split(":")[1].strip() for line in lines] == list(SPEC.joint_names)
    assert lines[0].startswith(f"action.kp: shoulder_pan: found {kp:g}, expected 3.37e+04 to 5.13e+04: ")


@pytest.mark.parametrize("kd", [1e6, 1e308, 1e-6])
def test_damping_out_of_bounds_names_joint_value_and_bounds(kd):
    lines = misfits(SPEC, OWN.kp, kd)
    assert len(lines) == N
    assert lines[0].startswith(f"action.kd: shoulder_pan: found {kd:g}, expected 632 to 1.34e+03: ")


def test_one_joint_is_named_alone():
    kd = OWN.kd.copy()
    kd[3] *= 10
    assert [line.split(":")[1] for line in misfits(SPEC, OWN.kp, kd)] == [" wrist_1"]


def largest_damping():
    """Return the largest damping of the first joint that is accepted with its own stiffness, by bisection."""
    low, high = OWN.kd[0], 1e6
    for _ in range(40):
        middle = 0.5 * (low + high)
        kd = np.where(np.arange(N) == 0, middle, OWN.kd)
        low, high = (low, middle) if misfits(SPEC, OWN.kp, kd) else (middle, high)
    return low


@pytest.mark.parametrize("gain", [0.999, 1.001])
def test_loop_at_the_bound_of_damping_is_stable_by_just_the_margin(gain):
    """Oracle: eigenvalues of the sampled loop: qd' = qd − T (kp q + kd qd) / J, q' = q + T qd'."""
    kd, kp = gain * GAIN_MARGIN * largest_damping(), GAIN_MARGIN * OWN.kp[0]
    inertia, period = joint_inertia(SPEC).rotor[0], 1.0 / SPEC.rates.physics_hz
    speed = np.array([-period * kp / inertia, 1.0 - period * kd / inertia])
    loop = np.array([np.array([1.0, 0.0]) + period * speed, speed])
    assert (np.abs(np.linalg.eigvals(loop)).max() < 1.0) == (gain < 1.0)


def test_a_wheel_has_no_stiffness_but_damping_for_its_load():
    own = drive_gains(PLANAR4)
    kp = np.where(np.arange(PLANAR4.n) == 3, 0.0, own.kp)
    assert misfits(PLANAR4, kp, own.kd, "velocity") == []
    kd = np.where(np.arange(PLANAR4.n) == 3, 1e-6, own.kd)
    (line,) = misfits(PLANAR4, kp, kd, "velocity")
    assert line.startswith("action.kd: wrist_roll: found 1e-06, expected ")


@pytest.mark.parametrize("mode", ["position", "velocity"])
def test_an_arm_at_the_bound_of_stiffness_keeps_three_quarters_of_its_clearances(mode):
    """Each joint alone, under all the load that a setpoint leaves to it, at the end of its lever."""
    control_mode, levers = ControlMode[mode.upper()], joint_levers(SPEC)
    load = (1.0 - SPEC.margins.of(control_mode).tau) * torque_max(SPEC)
    way = load / stiffness_bounds(SPEC, control_mode).low * levers
    clearance = min(SPEC.margins.workspace_m, SPEC.margins.collision_m)
    assert (way <= 0.25 * clearance * (1 + 1e-12)).all()
    assert way[1] == pytest.approx(0.25 * clearance)


def test_a_model_without_rotors_is_bounded_by_its_links(tmp_path):
    folder = copy_of_arm(tmp_path, xml=[(r' armature="1.0201"', "")])
    inertia = joint_inertia(load_robot(folder))
    np.testing.assert_array_equal(inertia.rotor[:3], inertia.least[:3])
    np.testing.assert_allclose(inertia.rotor[3:], 0.204, rtol=1e-3)
