import numpy as np
import pytest

from deploy.policy.contract_action import ActionSpec
from deploy.policy.gain_bounds import GAIN_MARGIN, damping_bounds, gain_misfits, stiffness_bounds
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
    named = [line.split(":")[1].strip() for line in lines if line.startswith("action.kp: ")]
    assert named == list(SPEC.joint_names)
    assert lines[0].startswith(f"action.kp: shoulder_pan: found {kp:g}, expected 28014.3 to 48222: ")


@pytest.mark.parametrize("kd", [1e6, 1e308, 1e-6])
def test_damping_out_of_bounds_names_joint_value_and_bounds(kd):
    lines = misfits(SPEC, OWN.kp, kd)
    assert len(lines) == N
    assert lines[0].startswith(f"action.kd: shoulder_pan: found {kd:g}, expected 632.083 to 687.139: ")


def test_one_joint_is_named_alone():
    kd = OWN.kd.copy()
    kd[3] *= 10
    assert [line.split(":")[1] for line in misfits(SPEC, OWN.kp, kd)] == [" wrist_1"]


@pytest.mark.parametrize("gain", [0.999, 1.001])
def test_loop_at_the_bound_of_damping_is_stable_by_just_the_margin(gain):
    """Oracle: eigenvalues of the sampled loop: qd' = qd − T (kp q + kd qd) / J, q' = q + T qd'. Of the last joint."""
    most = damping_bounds(SPEC, ControlMode.POSITION, OWN.kp).high[-1]
    kd, kp = gain * GAIN_MARGIN * most, GAIN_MARGIN * OWN.kp[-1]
    inertia, period = joint_inertia(SPEC).rotor[-1], 1.0 / SPEC.rates.physics_hz
    speed = np.array([-period * kp / inertia, 1.0 - period * kd / inertia])
    loop = np.array([np.array([1.0, 0.0]) + period * speed, speed])
    assert (np.abs(np.linalg.eigvals(loop)).max() < 1.0) == (gain < 1.0)


def test_at_the_bound_of_damping_a_blow_in_the_play_takes_the_torque_that_plans_leave():
    """Oracle: the shoulder's link, at the inertia that is worst, is driven through the play and hits its rotor."""
    inertia, load = joint_inertia(SPEC), (1.0 - SPEC.margins.tau) * torque_max(SPEC)[0]
    link = np.linspace(inertia.least[0] - inertia.rotor[0], inertia.most[0] - inertia.rotor[0], 1000)
    time = np.sqrt(2.0 * SPEC.joint_array("play")[0] * link / load)
    speed = load / link * time * link / (link + inertia.rotor[0])
    assert damping_bounds(SPEC, ControlMode.POSITION, OWN.kp).high[0] * speed.max() == pytest.approx(load)


def test_gears_without_play_take_no_blow(tmp_path):
    folder = copy_of_arm(tmp_path, toml=[("play = 0.00035", "play = 0.0")])
    high = [damping_bounds(each, ControlMode.POSITION, OWN.kp).high for each in (SPEC, load_robot(folder))]
    assert high[1][0] == pytest.approx(1339.7, rel=1e-4)
    np.testing.assert_array_equal(high[0][1:], high[1][1:])


@pytest.mark.parametrize("spec", [SPEC, PLANAR4, QUADRUPED], ids=lambda spec: spec.name)
@pytest.mark.parametrize("end", ["low", "high"])
def test_at_both_ends_of_stiffness_there_is_a_damping(spec, end):
    kp = getattr(stiffness_bounds(spec, ControlMode.POSITION), end)
    damping = damping_bounds(spec, ControlMode.POSITION, kp)
    assert (damping.low <= damping.high * (1 + 1e-12)).all()


def test_a_wheel_has_no_stiffness_but_damping_for_its_load():
    own = drive_gains(PLANAR4)
    kp = np.where(np.arange(PLANAR4.n) == 3, 0.0, own.kp)
    assert misfits(PLANAR4, kp, own.kd, "velocity") == []
    kd = np.where(np.arange(PLANAR4.n) == 3, 1e-6, own.kd)
    (line,) = misfits(PLANAR4, kp, kd, "velocity")
    assert line.startswith("action.kd: wrist_roll: found 1e-06, expected ")


@pytest.mark.parametrize("of_motors", [("position", "velocity", "torque"), ("position", "velocity")])
@pytest.mark.parametrize("mode", ["position", "velocity"])
def test_an_arm_at_the_bound_of_stiffness_keeps_three_quarters_of_its_clearances(mode, of_motors):
    """Each joint alone, under all the load that setpoints leave, at the end of its lever.

    Drives without a torque mode have no loop around the current, and windings of 110 °C.
    """
    motors = {name: motor.model_copy(update={"modes": of_motors}) for name, motor in SPEC.motors.items()}
    spec = SPEC.model_copy(update={"motors": motors})
    control_mode, levers = ControlMode[mode.upper()], joint_levers(SPEC)
    load = (1.0 - SPEC.margins.of(control_mode).tau) * torque_max(SPEC)
    hot = 1.0 if "torque" in of_motors else 1.0 + 0.0039 * (110.0 - 25.0)  # copper
    way = load * hot / stiffness_bounds(spec, control_mode).low * levers
    clearance = min(SPEC.margins.workspace_m, SPEC.margins.collision_m)
    assert (way <= 0.25 * clearance * (1 + 1e-12)).all()
    assert way[1] == pytest.approx(0.25 * clearance)


def test_a_model_without_rotors_is_bounded_by_its_links(tmp_path):
    folder = copy_of_arm(tmp_path, xml=[(r' armature="1.0201"', "")])
    inertia = joint_inertia(load_robot(folder))
    np.testing.assert_array_equal(inertia.rotor[:3], inertia.least[:3])
    np.testing.assert_allclose(inertia.rotor[3:], 0.204, rtol=1e-3)
