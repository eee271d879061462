import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.motion.drive_law import SpringDrives
from deploy.operation.stop_explanation import explain_reasons
from deploy.policy.compatibility import check_contract
from deploy.policy.contract_action import ActionSpec
from deploy.reasons import Reason
from deploy.safety.check import AHEAD_S
from deploy.state import Mode
from deploy.tasks.velocity import Velocity
from robots.errors import ContractError, RobotError
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.randomness import robot_seed
from robots.rotations import exp, matrix, matvec
from robots.spec import load_robot
from support.walking import (
    ARM_S,
    KD,
    KP,
    PLACES,
    QUADRUPED,
    STAND,
    TERMS,
    changed,
    live,
    simulate,
    standing,
    walker,
    walking_contract,
)

sensor_faults = pytest.importorskip("deploy.backends.sim.sensor_faults")
Failure, Fault = sensor_faults.Failure, sensor_faults.Fault

Judge = pytest.importorskip("eval.judge.judge").Judge
FallCriterion = pytest.importorskip("eval.judge.falls").FallCriterion
BaseTruth = pytest.importorskip("deploy.truth").BaseTruth
judge_tick = pytest.importorskip("eval.shard.judging").judge_tick
ignore_reasons = pytest.importorskip("eval.mutants.guard_removal").ignore_reasons

DT, TORQUE_MAX = QUADRUPED.dt, torque_max(QUADRUPED)
FRONT_ABDUCTIONS = [0, 3]
FRONT_HIPS, REAR_KNEES = [1, 4], [8, 11]
FOOT_RADIUS = 0.02
"""m, by which the middle of a foot is above the floor; the IMU is in the middle of the base."""
HIPS, KNEES = slice(1, None, 3), slice(2, None, 3)


def reading(observation, name):
    """A term as it was measured."""
    one = next(t for t in TERMS if t.name == name)
    return observation[:, PLACES[name]] * one.scale + (one.offset or 0.0)


def bits(runtime):
    """Everything that a tick leaves behind."""
    base = runtime.state.base
    return np.concatenate(
        [
            runtime.robot.plant.rows,
            runtime.command.q,
            runtime.state.q,
            base.quat_wxyz,
            base.velocity_in_base,
            runtime.capabilities.by_name["floating_base"].filter.P.reshape(len(base.age), -1),
            runtime.task.success.total,
        ],
        axis=1,
    )


def sway(tick):
    """(12,) rad: something to do."""
    return 0.1 * np.sin(2 * np.pi * (0.5 * tick * DT + np.arange(12) / 12))


def test_robot_hangs_until_armed_and_then_stands():
    runtime = walker(3)
    live(runtime, round(ARM_S / DT))
    base = runtime.robot.truth().base
    hung, plant = base.position.copy(), runtime.robot.plant
    np.testing.assert_allclose(hung[:, 2], plant.base.stands_m, atol=0.005)  # what holds it gives a little
    assert plant.on_gantry.all()
    assert not runtime.arm(np.ones(3, dtype=bool)).any()
    live(runtime, round(2.0 / DT))
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    assert not plant.on_gantry.any()
    assert np.abs(base.position - hung).max() < 0.03
    assert not runtime.robot.truth().self_collision.any()
    assert (runtime.robot.truth().contact_n > 10.0).all()


def test_robot_hangs_where_it_will_stand(tmp_path):
    """Half a metre too high in model.xml: no gantry pulls it down while its orientation is first measured."""
    folder = shutil.copytree(QUADRUPED.folder, tmp_path / "quadruped")
    text = (folder / "model.xml").read_text()
    (folder / "model.xml").write_text(
        text.replace('name="trunk" pos="0 0 0.33"', 'name="trunk" pos="0 0 0.83"')
    )
    spec, seeds = load_robot(folder), [robot_seed(3, 0)]
    contract = walking_contract(spec)
    runtime, robot = simulate(spec, contract, seeds)
    live(runtime, round(ARM_S / DT))
    np.testing.assert_allclose(robot.truth().base.position[0, 2], robot.plant.base.stands_m, atol=0.005)
    assert robot.plant.base.stands_m < 0.4
    assert not runtime.arm(np.ones(1, dtype=bool)).any()


@pytest.mark.slow
def test_base_sensors_follow_the_base():
    runtime = standing(4)
    base = runtime.robot.truth().base
    for tick in range(0, 400, 4):
        observation = live(runtime, 4, sway(tick))
        R = matrix(base.quat_wxyz)
        for name, true, close in (
            ("projected_gravity", -R[:, 2], 0.04),
            ("base_linear_velocity", np.matvec(R.swapaxes(1, 2), base.velocity), 0.12),
        ):
            np.testing.assert_allclose(reading(observation, name), true, atol=close, err_msg=name)
    turning = runtime.state.base.angular_velocity - base.angular_velocity
    assert np.sqrt((turning**2).mean()) < 0.1
    assert runtime.state.base.age.max() < 0.02


def test_gait_phase_starts_at_arming():
    runtime = standing(2)
    observation = live(runtime, 1)
    t = (runtime.ticks_since_arming - 1) * DT
    phase = 2 * np.pi * t / 0.4
    np.testing.assert_allclose(
        reading(observation, "gait_phase"), np.stack((np.sin(phase), np.cos(phase)), axis=1), atol=1e-5
    )


def test_drives_have_the_contract_gains_and_get_positions_only():
    runtime = standing(2)
    live(runtime, 100, sway(30))
    assert not runtime.command.qd.any()
    assert not runtime.command.tau.any()
    drawn, plant = runtime.robot.draw, runtime.robot.plant
    stray = runtime.command.q - plant.kinematics.motor_q
    law = KP * drawn["drives.kp"] * stray - KD * drawn["drives.kd"] * plant.kinematics.motor_qd
    np.testing.assert_allclose(runtime.robot.truth().tau, law, atol=1.5)
    np.testing.assert_allclose(runtime.verdict.tau, law, atol=10.0)  # of nominal gains and believed angles


def test_brake_stiffness_does_not_depend_on_the_policy_gains():
    """Or a robot that has lost its power would hang in its policy's springs."""
    action = walking_contract().action.model_copy(update={"kp": (90.0,) * 12, "kd": (3.0,) * 12})
    drives = (runtime := walker(2, contract=walking_contract(action=action))).robot.plant.drives
    own = [gain.copy() for gain in drives.gains]
    square = runtime.robot.plant.batch.model.actuator_gear[:, 0] ** 2
    live(runtime, round(ARM_S / DT))
    runtime.arm(np.array([True, False]))
    live(runtime, 20)
    draw = runtime.robot.draw
    for name, gain, brake, x in zip(("kp", "kd"), drives.gains, own, (90.0, 3.0), strict=True):
        np.testing.assert_allclose(gain[0], (x / square * draw[f"drives.{name}"])[0])
        np.testing.assert_array_equal(gain[1], brake[1])
        assert (gain[0] != brake[0]).all()
    kept = runtime.robot.save()
    runtime.robot.stop(np.array([True, True]))
    for gain, brake in zip(drives.gains, own, strict=True):
        np.testing.assert_array_equal(gain, brake)
    runtime.robot.restore(kept)
    assert (drives.gains[0][0] != own[0][0]).all()


def test_drive_springs_are_limited_to_the_drive_torque():
    runtime = standing(1)
    springs, q = SpringDrives(QUADRUPED, runtime.contract.action.gains), STAND + 2.0
    tau = springs.torque(runtime.state, np.tile(q, (2, 1)), np.zeros((2, 12)), np.zeros((2, 12)))
    np.testing.assert_array_equal(tau, np.full((2, 12), 40.0))


@pytest.mark.slow
def test_robot_alone_equals_the_same_robot_in_a_group():
    three, alone = standing(3), standing(1)
    for tick in range(60):
        live(three, 1, sway(tick))
        live(alone, 1, sway(tick))
    np.testing.assert_array_equal(bits(three)[:1], bits(alone))


def test_saved_and_restored_goes_on_bit_for_bit():
    one = standing(2)
    live(one, 50, sway(0))
    kept, body = one.save(), one.robot.save()
    live(one, 80, sway(7))
    other = walker(2)
    other.restore(kept)
    other.robot.restore(body)
    live(other, 80, sway(7))
    np.testing.assert_array_equal(bits(other), bits(one))


@pytest.mark.slow
def test_fall_latches_the_supervisor():
    runtime = standing(2)
    legs = np.zeros((2, 12))
    legs[1, FRONT_HIPS], legs[1, REAR_KNEES] = 1.0, 1.0
    for _ in range(40):
        live(runtime, 20, legs)
        runtime.robot.plant.batch.bind("xfrc_applied")[1, 1, :3] = 0.0, 150.0, 0.0  # somebody kicks it over
    assert Reason(int(runtime.supervisor.reason[1])) & Reason.FALLEN
    assert runtime.supervisor.mode.tolist() == [Mode.RUNNING, Mode.LATCHED]
    assert runtime.supervisor.powered.tolist() == [True, False]
    tilt = np.arccos(matrix(runtime.robot.truth().base.quat_wxyz)[:, 2, 2])
    assert tilt[0] < 0.1 < QUADRUPED.base.tilt_max_rad < tilt[1]


@pytest.mark.slow
def test_folded_legs_latch_the_supervisor():
    """It sinks without tilting."""
    runtime = standing(2)
    legs = np.zeros((2, 12))
    for share in np.linspace(0.0, 1.0, 200):
        legs[1, HIPS], legs[1, KNEES] = 0.6 * share, -1.1 * share
        live(runtime, 1, legs)
        if runtime.supervisor.reason[1] & Reason.FALLEN:
            break
    assert runtime.supervisor.mode[1] == Mode.LATCHED
    assert "base_height" in explain_reasons(runtime, Reason.FALLEN, 1)
    base, low = runtime.robot.truth().base, runtime.state.base.height
    np.testing.assert_allclose(low, base.position[:, 2] - FOOT_RADIUS, atol=0.01)
    assert base.position[1, 2] < 1.3 * QUADRUPED.base.height_min_m < base.position[0, 2]
    assert matrix(base.quat_wxyz)[1, 2, 2] > 0.95


def test_a_robot_that_drops_latches_before_it_is_low():
    """It folds its legs at once, and somebody presses it down."""
    runtime, legs = standing(2), np.zeros((2, 12))
    legs[1, HIPS], legs[1, KNEES] = 0.6, -1.1
    for _ in range(60):
        runtime.robot.plant.batch.bind("xfrc_applied")[1, 1, 2] = -100.0
        live(runtime, 1, legs)
        if runtime.supervisor.reason[1] & Reason.FALLEN:
            break
    assert "base_descent" in explain_reasons(runtime, Reason.FALLEN, 1)
    assert runtime.supervisor.mode.tolist() == [Mode.RUNNING, Mode.LATCHED]
    assert runtime.robot.truth().base.velocity[1, 2] == pytest.approx(-QUADRUPED.base.descent_max, abs=0.2)
    assert runtime.state.base.height[1] > 1.5 * QUADRUPED.base.height_min_m


@pytest.mark.parametrize(("share", "falls"), [(0.99, False), (1.01, True), (-1.01, False)])
def test_legs_that_will_meet_at_their_speed_mean_a_fall(share, falls):
    """Setpoints stay where the robot stands."""
    runtime, inward = standing(2), np.zeros(12)
    inward[FRONT_ABDUCTIONS] = -1.0, 1.0
    q = runtime.state.q[1]
    meet = next(
        angle
        for angle in np.linspace(0.0, 1.0, 10_001)
        if runtime.safety.check_poses(np.tile(q + angle * inward, (4, 1)))[0] & Reason.COLLISION
    )
    qd = np.outer((0.0, share * meet / AHEAD_S), inward)
    here = runtime.setpoint
    stop = runtime.smoother.brake(here)
    verdict = runtime.safety.step(runtime.state._replace(qd=qd), here, here, stop)
    found = [runtime.safety.failed(verdict, robot, Reason.FALLEN) for robot in (0, 1)]
    assert ["self_collision_ahead" in checks for checks in found] == [False, falls]


@pytest.mark.parametrize(
    ("sensor", "what", "reason"),
    [
        ("gyro", Failure.OFF, Reason.STALE),
        ("gyro", Failure.STUCK, Reason.STUCK),
        ("accelerometer", Failure.OFF, Reason.STALE),
        ("accelerometer", Failure.STUCK, Reason.STUCK),
    ],
)
@pytest.mark.slow
def test_an_imu_that_fails_stops_the_robot(sensor, what, reason):
    fault = Fault(robot=0, sensor=sensor, channel=None, what=what, begins=400, ends=10**6)
    runtime = standing(2, faults=[fault])
    assert (runtime.supervisor.mode == Mode.RUNNING).all()
    live(runtime, 200)
    assert Reason(int(runtime.supervisor.reason[0])) & reason
    assert runtime.supervisor.mode.tolist() == [Mode.LATCHED, Mode.RUNNING]


def test_a_base_may_carry_a_tool(tmp_path):
    """Its feet are where they were."""
    spec = load_robot(changed(tmp_path, ('name = "quadruped"', 'name = "quadruped"\ntool = "imu"')))
    assert spec.capabilities == QUADRUPED.capabilities | {"tool"}
    q, qd, both = STAND[None], np.ones((1, 12)), []
    for robot in (spec, QUADRUPED):
        fleet = Fleet(robot, 1, collisions=True)
        kinematics = fleet.kinematics(q)
        both.append((kinematics.feet_position, kinematics.feet_velocity(qd)))
    np.testing.assert_array_equal(*both)


@pytest.mark.slow
def test_commands_are_counted_as_followed():
    runtime = standing(2)
    period = round(QUADRUPED.base.command_s / DT)
    runtime.task.elapsed[:], runtime.task.attempted[:], runtime.task.reached[:] = 0, 0, 0
    runtime.task.success.total[:] = 0.0
    live(runtime, period)
    np.testing.assert_array_equal(runtime.task.goal, 0.0)  # it may be asked for nothing but to stand
    assert runtime.task.attempted.tolist() == runtime.task.reached.tolist() == [1, 1]
    runtime.stop(Reason.OPERATOR)
    live(runtime, period)
    assert runtime.task.attempted.tolist() == [2, 2]
    assert runtime.task.reached.tolist() == [1, 1]


def test_velocity_contract_needs_a_walking_robot():
    standing_still = TERMS[0].model_copy(
        update={"name": "tool", "source": "tool_position", "frame": "world", "unit": "m"}
    )
    with pytest.raises(ContractError) as caught:
        check_contract(walking_contract(task="reach", observation=(standing_still,)), QUADRUPED, "walk.onnx")
    assert str(caught.value).splitlines() == [
        "walk.onnx: task: found 'reach', which needs [tool, workspace]; quadruped has floating_base, self_collision",
        "walk.onnx: observation.tool.source: tool_position needs tool; quadruped has floating_base, self_collision",
    ]
    check_contract(walking_contract(), QUADRUPED, "walk.onnx")


def test_policy_without_gains_gets_feed_forward():
    action = ActionSpec(mode="position", size=12, offset=tuple(STAND), scale=(1.0,) * 12, clip=(-1.0, 1.0))
    runtime = walker(1, contract=walking_contract(action=action))
    assert runtime.springs is None


def test_feet_are_measured_in_the_base_frame():
    rng, robots, step = np.random.default_rng(0), 3, 1e-6
    fleet = Fleet(QUADRUPED, robots)
    q, qd = STAND + rng.uniform(-0.3, 0.3, (robots, 12)), rng.normal(size=(robots, 12))
    kinematics = fleet.kinematics(q)
    before, velocity = kinematics.feet_position.copy(), kinematics.feet_velocity(qd)
    kinematics = fleet.kinematics(q + step * qd)
    np.testing.assert_allclose((kinematics.feet_position - before) / step, velocity, atol=1e-5)
    kinematics = fleet.kinematics(np.tile(STAND, (robots, 1)))
    np.testing.assert_allclose(kinematics.feet_position[0, :, 0], [0.18, 0.18, -0.18, -0.18], atol=0.02)
    assert (kinematics.feet_position[0, :, 2] < -0.25).all()


def judged(runtime, ticks, action=None):
    """What the judge finds while it lives."""
    judge = Judge(QUADRUPED, TORQUE_MAX, runtime.robot.robots, criterion=runtime.task.criterion)
    for tick in range(ticks):
        live(runtime, 1, action if action is None else action(tick))
        judge_tick(judge, runtime.robot.truth(), runtime, None)
    return judge.counts()


@pytest.mark.slow
def test_judge_counts_falls_and_followed_commands():
    runtime = standing(2)
    period = round(QUADRUPED.base.command_s / DT)
    runtime.task.elapsed[:], runtime.task.attempted[:] = 0, 0
    kick = runtime.robot.plant.batch.bind("xfrc_applied")

    def rocking(tick):
        kick[1, 1, :3] = 0.0, 150.0 * (tick > period + 20), 0.0
        legs = np.zeros((2, 12))
        legs[1, FRONT_HIPS], legs[1, REAR_KNEES] = 1.0 * (tick > period), 1.0 * (tick > period)
        return legs

    counts = judged(runtime, 2 * period, rocking)
    assert counts.events[:, counts.columns("tilt")].ravel().tolist() == [0, 1]
    assert counts.attempted.tolist() == [2, 2]
    assert counts.reached.tolist() == [2, 1]
    assert counts.worst[0, counts.columns("tilt")][0] < 0.2
    assert np.isinf(
        counts.limits[[counts.columns(n).start for n in ("workspace", "singularity", "tool_speed")]]
    ).all()


@pytest.mark.parametrize(
    ("ignored", "events"),
    [(Reason.NONE, (0, 0)), (Reason.FALLEN | Reason.DIVERGED, (1, 0)), (~Reason.NONE, (1, 1))],
)
@pytest.mark.slow
def test_judge_detects_a_missing_fall_guard(ignored, events):
    """The mutant of FALLEN, which the arm of `make mutants` cannot have. Others take the power of who lies there."""
    runtime = standing(2)
    ignore_reasons(ignored)(runtime)
    kick = runtime.robot.plant.batch.bind("xfrc_applied")

    def rolls_over(tick):
        kick[1, 1, 3:] = 60.0 * (tick < 30), 0.0, 0.0
        return np.zeros((2, 12))

    counts = judged(runtime, round(2.0 / DT), rolls_over)
    assert counts.events[:, counts.columns("tilt")].ravel().tolist() == [0, 1]
    assert tuple(counts.total(monitor) for monitor in ("fallen", "powered_fallen")) == events


@pytest.mark.slow
def test_judge_detects_a_missing_height_guard():
    """It sinks without tilting, and no reason stops it."""
    runtime = standing(2)
    ignore_reasons(~Reason.NONE)(runtime)

    def fold(tick):
        legs, share = np.zeros((2, 12)), min(tick / 200, 1.0)
        legs[1, HIPS], legs[1, KNEES] = 0.9 * share, -1.1 * share
        return legs

    counts = judged(runtime, round(3.0 / DT), fold)
    for monitor in ("base_height", "powered_fallen"):
        assert counts.events[:, counts.columns(monitor)].ravel().tolist() == [0, 1]
    assert counts.total("tilt") == counts.total("fallen") == 0


@pytest.mark.parametrize("asked", [[0.0, 0.6, 0.0], [0.0, 0.0, 0.6]])
@pytest.mark.slow
def test_motion_other_than_commanded_is_not_counted(monkeypatch, asked):
    runtime = standing(1)
    period = round(QUADRUPED.base.command_s / DT)
    runtime.task.elapsed[:], runtime.task.attempted[:], runtime.task.reached[:] = 0, 0, 0
    runtime.task.success.total[:] = 0.0
    monkeypatch.setattr(runtime.task, "sample_goal", lambda rng: np.array(asked))
    runtime.task.goal[:] = asked
    counts = judged(runtime, 2 * period)
    assert counts.attempted.tolist() == runtime.task.attempted.tolist() == [2]
    assert counts.reached.tolist() == runtime.task.reached.tolist() == [0]


def test_judge_measures_the_angular_velocity_of_the_base():
    """About what is up in the world, however it leans."""
    rng = np.random.default_rng(2)
    quat, turning = exp(rng.normal(0.0, 0.8, (50, 3))), rng.normal(size=(50, 3))
    up = np.tile([0.0, 0.0, 1.0], (50, 1))
    base = BaseTruth(np.zeros((50, 3)), quat, np.zeros((50, 3)), turning, up)
    velocity = Velocity.true_achieved(SimpleNamespace(base=base))
    np.testing.assert_allclose(velocity[:, 2], matvec(matrix(quat), turning)[:, 2], atol=1e-12)


def test_judge_measures_the_base_tilt():
    rng = np.random.default_rng(2)
    quat, up = exp(rng.normal(0.0, 0.8, (50, 3))), rng.normal(size=(50, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    zero = np.zeros((50, 3))
    leans = FallCriterion(QUADRUPED).measure(BaseTruth(zero, quat, zero, zero, up)).tilt
    upright = matvec(matrix(quat).swapaxes(1, 2), up)  # seen from the base
    np.testing.assert_allclose(leans, np.arctan2(np.hypot(*upright.T[:2]), upright[:, 2]), atol=1e-7)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            (("collision_m = 0.005", "collision_m = 0.005\nsingularity = 0.1"),),
            r"margins\.singularity: found 0\.1, expected none of a robot without tool",
        ),
        ((("[sensors.gyro]", "[sensors.torque]"),), "sensors: no gyro, which a base needs"),
        (
            (("command_min = [0.0, 0.0, 0.0]", "command_min = [0.1, 0.0, 0.0]"),),
            r"base\.command_min: found 0\.1, above command_max 0\.0",
        ),
    ],
)
def test_missing_needs_of_a_base_are_named(tmp_path, changes, message):
    text = (('unit = "rad/s"\nsites = ["imu"]', 'unit = "N*m"\nsites = ["imu"]'),)
    torque = any("torque" in new for _, new in changes)
    with pytest.raises(RobotError, match=message):
        load_robot(changed(tmp_path, *changes, *(text if torque else ())))


def test_base_requires_a_free_joint_and_vice_versa(tmp_path):
    spec = load_robot(changed(tmp_path, ("      <freejoint/>\n", ""), file="model.xml"))
    with pytest.raises(RobotError, match=r"model\.xml: found no free joint at the root, expected one"):
        load_pinocchio(spec)


FORELEGS = '"front_left_shin", "front_right_shin"'


def crossed(spec):
    """(B,) whether a robot touches itself that stands with its front feet together."""
    seeds = [robot_seed(3, 0)]
    runtime, robot = simulate(spec, walking_contract(spec), seeds)
    live(runtime, round(ARM_S / DT))
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    touched, legs = False, np.zeros(12)
    legs[[0, 3]] = -0.7, 0.7
    for _ in range(200):
        live(runtime, 1, legs)
        touched |= bool(robot.truth().self_collision[0])
    return touched


def test_allowed_foot_contact_is_no_collision(tmp_path):
    assert crossed(QUADRUPED)
    may = ("[sensors.encoder]", f"[[may_touch]]\nbodies = [{FORELEGS}]\n\n[sensors.encoder]")
    brushing = load_robot(changed(tmp_path, may))
    assert not crossed(brushing)
    together = STAND.copy()
    together[[0, 3]] += -0.35, 0.35
    for spec, hits in ((QUADRUPED, True), (brushing, False)):
        fleet = Fleet(spec, 1, collisions=True)
        kinematics = fleet.kinematics(together[None])
        assert kinematics.colliding.tolist() == [hits]


def test_feet_that_may_touch_the_world_hide_no_collision(tmp_path):
    """Contacts with the floor never count as the robot's own."""
    pairs = "".join(
        f'[[may_touch]]\nbodies = [{shin}, "world"]\nforce_n = 2000.0\n\n' for shin in FORELEGS.split(", ")
    )
    spec = load_robot(changed(tmp_path, ("[sensors.encoder]", pairs + "[sensors.encoder]")))
    runtime, robot = simulate(spec, walking_contract(spec), [robot_seed(3, 0)])
    live(runtime, round(ARM_S / DT))
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    live(runtime, 20, np.zeros(12))
    assert (robot.truth().allowed_contact_n > 5.0).all()
    assert not robot.truth().self_collision.any()
    robot.plant.sensed[:, robot.plant.base.self_contacts] = 1.0
    assert robot.truth().self_collision.all()


def test_allowed_contacts_must_exist(tmp_path):
    pair = FORELEGS.replace("left_shin", "paw")
    may = ("[sensors.encoder]", f"[[may_touch]]\nbodies = [{pair}]\n\n[sensors.encoder]")
    with pytest.raises(RobotError, match=r"may_touch: found 'front_paw', expected a body of model"):
        simulate(load_robot(changed(tmp_path, may)), walking_contract(), [robot_seed(3, 0)])


def test_missing_foot_is_named(tmp_path):
    spec = load_robot(changed(tmp_path, ('feet = ["front_left",', 'feet = ["paw",')))
    with pytest.raises(RobotError, match=r"no site or body named 'paw', which robot\.toml calls a foot"):
        load_pinocchio(spec)
