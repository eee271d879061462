"""The IMU of a robot that walks: where it sits, and what it says of up."""

import numpy as np
import pytest

from deploy.reasons import Reason
from deploy.state import Mode, Packet
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.errors import RobotError
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio
from robots.randomness import robot_seed
from robots.rotations import matrix
from robots.spec import load_robot
from support.walking import ARM_S, QUADRUPED, STAND, changed, live, walking_contract

simulate = pytest.importorskip("deploy.simulation").simulate

SENSOR = """[sensors.{kind}]
unit = "{unit}"
sites = [{sites}]
rate_hz = 200
resolution = 1e-5
range = {range}
noise = 0.001
bias = 0.003
drift = 0.0
drift_per_k = 0.0
delay_s = 0.005
loss = 0.001
source = "estimate"

[motors.leg]
"""
UPRIGHT = SENSOR.format(kind="orientation", unit="quat_wxyz", sites='"imu"', range=1.1)


def feeling(*sites):
    listed = ", ".join(f'"{site}"' for site in sites)
    return ("[motors.leg]\n", SENSOR.format(kind="contact", unit="N", sites=listed, range=1000.0))


@pytest.fixture
def standing(tmp_path):
    """Two on feet that feel the ground, whose IMUs say where up is."""
    feel = feeling("front_left", "front_right", "rear_left", "rear_right")
    spec = load_robot(changed(tmp_path, ("[motors.leg]\n", UPRIGHT), feel))
    seeds = [robot_seed(3, robot) for robot in range(2)]
    runtime, _ = simulate(spec, walking_contract(spec), seeds)
    live(runtime, round(ARM_S / spec.dt))
    assert not runtime.arm(np.ones(2, dtype=bool)).any()
    live(runtime, 200)
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    return runtime


def truly_down(robot):
    """(B, 3) where gravity points, as seen from the base."""
    base = robot.truth().base
    return -np.matvec(matrix(base.quat_wxyz).swapaxes(1, 2), base.up)


def hearing(runtime, kind, change):
    """From now on packets of a sensor come changed."""
    read = runtime.robot.read
    runtime.robot.read = lambda: (sample := read()) | {kind: change(sample[kind])}


def test_robot_overturned_during_gyro_silence_is_not_estimated_upright(standing):
    noise = np.random.default_rng(0)
    hearing(standing, "gyro", lambda packet: packet._replace(value=noise.normal(0.0, 0.005, (2, 3))))
    speed = standing.robot.plant.batch.bind("qvel")
    speed[1, 3] += 9.0
    speed[1, 2] += 1.5
    live(standing, 200)
    leans = np.arccos(matrix(standing.robot.truth().base.quat_wxyz)[:, 2, 2])
    assert leans[0] < 0.1
    assert leans[1] > 2.0
    assert standing.supervisor.mode.tolist() == [Mode.RUNNING, Mode.LATCHED]
    assert Reason(int(standing.supervisor.reason[1])) & (Reason.DIVERGED | Reason.FALLEN)


@pytest.mark.slow
def test_repeated_gravity_directions_do_not_reduce_variance_below_the_bias(standing):
    live(standing, 1000)
    bias_var = 4 * 0.003**2 / 3
    claimed = np.sqrt(
        standing.capabilities.by_name["floating_base"].filter.P[:, :2, :2].trace(axis1=1, axis2=2)
    )
    wrong = np.linalg.norm(standing.state.base.gravity - truly_down(standing.robot), axis=1)
    assert (claimed > 0.5 * np.sqrt(2 * bias_var)).all()
    assert (wrong < 3 * claimed).all()


@pytest.mark.parametrize("tilt", [(0.1, 0.0), (0.0, -0.1)])
@pytest.mark.slow
def test_stance_is_known_on_a_tilted_floor(tmp_path, tilt):
    """What an IMU says of up is what its accelerometer feels: no acceleration is left over."""
    spec = load_robot(changed(tmp_path, ("[motors.leg]\n", UPRIGHT)))
    given = median_draw(load_distributions(spec), spec, 1).replaced({"mounting.tilt_rad": np.array([tilt])})
    runtime, robot = simulate(spec, walking_contract(spec), [robot_seed(3, 0)], draw=given)
    live(runtime, round(ARM_S / spec.dt))
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    live(runtime, 600)
    base = runtime.state.base
    assert np.abs(base.velocity_in_base).max() < 0.03
    assert np.abs(runtime.capabilities.by_name["floating_base"].filter.bias[:, 3:]).max() < 0.2
    np.testing.assert_allclose(-base.gravity, robot.plant.readings["accelerometer"] / 9.81, atol=0.01)


def test_packet_from_the_future_does_not_silence_the_gravity_direction(standing):
    once = iter([1e6])
    hearing(standing, "orientation", lambda packet: packet._replace(t=packet.t + next(once, 0.0)))
    live(standing, 100)
    assert (standing.t - standing.capabilities.by_name["floating_base"].t_up < 0.05).all()


def test_gravity_direction_counts_once_and_expires(standing):
    walker, now = standing.capabilities.by_name["floating_base"], standing.t
    gyro = Packet(np.full(2, now), np.ones(2, dtype=bool), np.zeros((2, 3)))
    told = Packet(np.array([now, now - 0.2]), np.ones(2, dtype=bool), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    walker.t_up[:] = -np.inf
    assert walker.measured_up(now, {"orientation": told}, gyro).fresh.tolist() == [True, False]
    assert walker.measured_up(now, {"orientation": told}, gyro).fresh.tolist() == [False, False]


def test_foot_positions_are_relative_to_the_imu_site(tmp_path):
    moved = load_robot(
        changed(tmp_path, ('<site name="imu"/>', '<site name="imu" pos="0.1 0 -0.02"/>'), file="model.xml")
    )
    seen = []
    for spec in (QUADRUPED, moved):
        fleet = Fleet(spec, 1)
        kinematics = fleet.kinematics(STAND[None])
        seen.append(kinematics.feet_position.copy())
    np.testing.assert_allclose(seen[0] - seen[1], np.tile([0.1, 0.0, -0.02], (1, 4, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        (
            "model.xml",
            ('<site name="imu"/>', '<site name="imu" euler="0 0 1.57"/>'),
            r"sensors\.gyro\.sites: 'imu' is turned by 1\.57 rad, expected the axes of the root body",
        ),
        (
            "robot.toml",
            ('unit = "m/s^2"\nsites = ["imu"]', 'unit = "m/s^2"\nsites = ["front_left"]'),
            r"sensors\.accelerometer\.sites: found 'front_left', expected 'imu', where the gyro is",
        ),
        (
            "robot.toml",
            ('sites = ["imu"]', 'sites = ["front_left"]'),
            r"sensors\.gyro\.sites: 'front_left' moves with '\w+', expected a site of the base itself",
        ),
        (
            "robot.toml",
            feeling("front_left"),
            r"sensors\.contact\.sites: found \['front_left'\], expected one at each of \['front_left', .*in that order",
        ),
        (
            "robot.toml",
            feeling("rear_right", "rear_left", "front_right", "front_left"),
            r"sensors\.contact\.sites: found \['rear_right', .*expected one at each of \['front_left',",
        ),
    ],
)
def test_sensor_sites_of_a_base_are_checked(tmp_path, file, change, message):
    spec = load_robot(changed(tmp_path, change, file=file))
    with pytest.raises(RobotError, match=message):
        load_pinocchio(spec)


def test_contact_sensors_follow_the_order_of_the_feet(tmp_path):
    load_pinocchio(
        load_robot(changed(tmp_path, feeling("front_left", "front_right", "rear_left", "rear_right")))
    )
