import numpy as np
import pytest

from deploy.reasons import LATCHING, Reason
from deploy.safety.safety import Safety
from deploy.state import Setpoint, State
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC
from support.deploy.safety import (
    HIGH,
    HOME,
    LOW,
    MARGINS,
    SAFETY,
    SPACE,
    ZERO,
    N,
    judge,
    one,
    point,
    reasons,
    stop_at,
)

TAU_MAX = MARGINS.tau * torque_max(SPEC)
HAIR = 1e-6


def test_home_pose_has_no_reasons():
    verdict = judge()
    assert verdict.reason.tolist() == [0]
    np.testing.assert_array_equal(verdict.tau, verdict.tau_ahead)


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("place", ["setpoint", "ahead", "q_rest"])
def test_position(joint, place):
    """The soft range, for what is sent, for the stop after it and for its end."""
    for end, inwards in ((LOW[joint] + MARGINS.q_soft_rad, 1), (HIGH[joint] - MARGINS.q_soft_rad, -1)):
        for beyond in (False, True):
            q = one(joint, end + (-HAIR if beyond else HAIR) * inwards, HOME)
            found = reasons(**{place: q if place == "q_rest" else point(q)}, q_hat=HOME)
            assert (Reason.POSITION in found) == beyond


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("sign", [-1, 1])
def test_velocity(joint, sign):
    limit = MARGINS.speed * SPEC.joints[joint].qd_max
    for factor, beyond in ((1 - HAIR, False), (1.0, False), (1 + 3 * HAIR, True)):
        fast = point(qd=one(joint, sign * factor * limit))
        assert (Reason.VELOCITY in reasons(setpoint=fast)) == beyond
        assert (Reason.VELOCITY in reasons(ahead=fast)) == beyond


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("sign", [-1, 1])
def test_velocity_gained_during_a_stop(joint, sign):
    """A stop first brings the acceleration to rest at full jerk, and the speed grows by its square over twice that."""
    limit, qdd = MARGINS.speed * SPEC.joints[joint].qd_max, SPEC.joints[joint].qdd_max
    gain = qdd**2 / (2 * SPEC.joints[joint].qddd_max)
    for factor, beyond in ((1 - HAIR, False), (1.0, False), (1 + 3 * HAIR, True)):
        qd = sign * (factor * limit - gain)
        rushing = point(qd=one(joint, qd), qdd=one(joint, sign * qdd))
        assert (Reason.VELOCITY in reasons(setpoint=rushing)) == beyond
        assert (Reason.VELOCITY in reasons(ahead=rushing)) == beyond
        assert Reason.VELOCITY not in reasons(setpoint=point(qd=one(joint, qd), qdd=one(joint, -sign * qdd)))


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("sign", [-1, 1])
def test_torque(joint, sign):
    """An acceleration that needs just less, or just more, than the joint may give."""
    fleet = Fleet(SPEC, 1)
    bias = fleet.torque(HOME[None], ZERO[None], ZERO[None])[0, joint].copy()
    slope = fleet.torque(HOME[None], ZERO[None], one(joint, 1.0)[None])[0, joint] - bias
    for factor, beyond in ((1 - HAIR, False), (1 + HAIR, True)):
        qdd = (sign * factor * TAU_MAX[joint] - bias) / slope
        hard = point(qdd=one(joint, qdd))
        verdict = judge(setpoint=hard)
        assert verdict.tau[0, joint] == pytest.approx(sign * factor * TAU_MAX[joint], rel=1e-9)
        others = np.delete(np.abs(verdict.tau[0]) <= TAU_MAX, joint).all()
        assert others
        assert (Reason.TORQUE in Reason(int(verdict.reason[0]))) == beyond
        assert (Reason.TORQUE in reasons(ahead=hard)) == beyond


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_hot_drive_may_give_its_share_of_the_torque_and_its_stop_all_of_it(joint, sign):
    fleet, share = Fleet(SPEC, 1), one(joint, MARGINS.fold_min, np.ones(N))
    bias = fleet.torque(HOME[None], ZERO[None], ZERO[None])[0, joint].copy()
    slope = fleet.torque(HOME[None], ZERO[None], one(joint, 1.0)[None])[0, joint] - bias
    for factor, beyond in ((1 - HAIR, False), (1 + HAIR, True)):
        tau = sign * factor * MARGINS.fold_min * TAU_MAX[joint]
        hard = point(qdd=one(joint, (tau - bias) / slope))
        found = judge(setpoint=hard, ahead=point(), current_share=share)
        assert found.tau[0, joint] == pytest.approx(tau, rel=1e-9)
        assert (Reason.TORQUE in Reason(int(found.reason[0]))) == beyond
        assert Reason.TORQUE not in reasons(setpoint=point(), ahead=hard, current_share=share)


@pytest.mark.parametrize("seed", range(3))
def test_tool_speed(seed):
    fleet, direction = Fleet(SPEC, 1), np.random.default_rng(seed).normal(size=N)
    kinematics = fleet.kinematics(HOME[None])
    direction /= np.linalg.norm(kinematics.tool_velocity(direction[None]))
    for factor, beyond in ((1 - HAIR, False), (1 + HAIR, True)):
        limit = direction * factor * SPEC.margins.tool_speed * SPACE.tool_speed_max
        assert (Reason.TOOL_SPEED in reasons(setpoint=point(qd=limit))) == beyond


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_tool_speed_gained_during_a_stop(joint, sign):
    """A stop first brings the acceleration to rest at full jerk, and the speed grows by its square over twice that."""
    fleet, jerk = Fleet(SPEC, 1), SPEC.joint_array("qddd_max")[joint]
    kinematics = fleet.kinematics(HOME[None])
    per_speed = np.linalg.norm(kinematics.tool_velocity(one(joint, 1.0)[None]))
    limit, qdd = SPEC.margins.tool_speed * SPACE.tool_speed_max / per_speed, 8.0
    for factor, beyond in ((1 - HAIR, False), (1 + HAIR, True)):
        qd = factor * limit - qdd**2 / (2 * jerk)
        rushing = point(qd=one(joint, sign * qd), qdd=one(joint, sign * qdd))
        assert (Reason.TOOL_SPEED in reasons(setpoint=rushing)) == beyond
        easing = point(qd=one(joint, sign * qd), qdd=one(joint, -sign * qdd))
        assert Reason.TOOL_SPEED not in reasons(setpoint=easing)


def test_setpoint_pose_is_checked_for_collisions():
    """Not only where the stop ends: a setpoint in the table, or in a singularity, is refused though its rest is not."""
    low = one(1, -0.35, one(2, 1.2, HOME))
    found = reasons(setpoint=point(low), ahead=point(), q_hat=HOME, q_rest=HOME)
    assert Reason.COLLISION in found
    assert Reason.WORKSPACE in found
    straight = one(4, 0.0, HOME)
    assert Reason.SINGULARITY in reasons(setpoint=point(straight), ahead=point(), q_hat=HOME, q_rest=HOME)


@pytest.mark.parametrize("joint", range(N))
def test_a_joint_found_outside_its_range_is_category_1(joint):
    for end, outwards in ((LOW[joint], -1), (HIGH[joint], 1)):
        for factor, beyond in ((-HAIR, False), (HAIR, True)):
            q_hat = one(joint, end + outwards * factor, HOME)
            assert (Reason.OUTSIDE in reasons(q_hat=q_hat)) == beyond
    assert Reason.OUTSIDE & LATCHING


@pytest.mark.parametrize("joint", range(N))
def test_heat(joint):
    limit = SPEC.motor_array("housing_max_c")[joint]
    assert reasons(housing_c=one(joint, limit, np.full(N, 20.0))) == 0
    assert reasons(housing_c=one(joint, limit + HAIR, np.full(N, 20.0))) == Reason.HEAT
    assert reasons(housing_c=one(joint, np.nan, np.full(N, 20.0))) == Reason.HEAT


@pytest.mark.parametrize("joint", range(N))
def test_winding_possibly_above_its_limit_stops_the_robot(joint):
    limit = SPEC.motor_array("winding_max_c")[joint]
    assert reasons(hottest_c=one(joint, limit, np.full(N, 20.0))) == 0
    assert reasons(hottest_c=one(joint, limit + HAIR, np.full(N, 20.0))) == Reason.HEAT
    assert reasons(hottest_c=one(joint, np.nan, np.full(N, 20.0))) == Reason.HEAT


@pytest.mark.parametrize(
    ("age", "expected"),
    [
        (0.0, 0),
        (MARGINS.stale_s - HAIR, 0),
        (MARGINS.stale_s + HAIR, 0),
        (MARGINS.stale_s + SPEC.dt - HAIR, Reason.STALE),
        (MARGINS.lost_s + HAIR, Reason.STALE),
        (MARGINS.lost_s + SPEC.dt - HAIR, Reason.STALE | Reason.LOST),
        (np.inf, Reason.STALE | Reason.LOST),
        (np.nan, Reason.STALE | Reason.LOST),
    ],
)
def test_stale_and_lost(age, expected):
    assert reasons(age=age) == expected


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("sign", [-1, 1])
def test_tracking_error_is_against_the_sent_setpoint(joint, sign):
    for offset, expected in (
        (MARGINS.tracking_rad - HAIR, 0),
        (MARGINS.tracking_rad + HAIR, Reason.TRACKING),
    ):
        sent = point(one(joint, HOME[joint] + sign * offset, HOME))
        assert reasons(sent=sent, q_hat=HOME) == expected
        assert reasons(setpoint=sent, q_hat=HOME, q_rest=HOME, ahead=point()) & Reason.TRACKING == 0


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("joint", [0, 5])
def test_non_finite_value_in_any_input(bad, joint):
    for field in ("q", "qd", "qdd"):
        broken = point(**{field: one(joint, bad, HOME if field == "q" else ZERO)})
        for place in ("setpoint", "ahead"):
            found = reasons(**{place: broken}, q_hat=HOME, q_rest=HOME)
            assert Reason.NOT_FINITE in found, (place, field)
    assert Reason.NOT_FINITE in reasons(q_hat=one(joint, bad, HOME), setpoint=point())
    assert Reason.NOT_FINITE in reasons(qd_hat=one(joint, bad))
    if np.isnan(bad):
        assert reasons(q_rest=one(joint, bad, HOME)) != 0


def by_mujoco(mujoco, poses):
    """The oracle for poses: another library, other formulas. One row: height, radius, |det J|, nearest distance."""
    from robots.models.mujoco_model import load_mujoco

    model = load_mujoco(SPEC)
    data, site = mujoco.MjData(model), model.site(SPEC.tool).id
    bodies = model.geom_bodyid
    pairs = [
        (a, b)
        for a in range(model.ngeom)
        for b in range(a)
        if max(bodies[a], bodies[b]) > 1 and abs(max(bodies[a], 1) - max(bodies[b], 1)) > 1
    ]
    rows, jacobian, fromto = [], np.zeros((6, N)), np.zeros(6)
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        tool = data.site_xpos[site]
        nearest = min(mujoco.mj_geomDistance(model, data, a, b, 0.1, fromto) for a, b in pairs)
        rows.append((tool[2], np.linalg.norm(tool - SPACE.centre), np.linalg.det(jacobian), nearest))
    return np.array(rows).T


def test_pose_checks_agree_with_mujoco():
    """Workspace, singularity and collision of 3,000 random poses in the working range, each bit both ways."""
    mujoco = pytest.importorskip("mujoco")
    robots, width, rng = 3072, 64, np.random.default_rng(0)
    q = rng.uniform(LOW, HIGH, (robots, N))
    _, _, home_side, _ = np.sign(by_mujoco(mujoco, HOME[None]))
    height, radius, determinant, nearest = by_mujoco(mujoco, q)
    manipulability = home_side * determinant
    singularity = 0.01  # more than the arm's own, so that enough poses lie on either side
    spec = SPEC.model_copy(update={"margins": MARGINS.model_copy(update={"singularity": singularity})})
    reason, safety = np.zeros(robots, dtype=np.int64), Safety(spec, Fleet(spec, width, collisions=True))
    for rows in np.split(np.arange(robots), robots // width):
        reason[rows] = safety.check_poses(q[rows])
    soft = MARGINS.q_soft_rad
    z_min, radius_max = SPACE.z_min + MARGINS.workspace_m, SPACE.radius_max - MARGINS.workspace_m
    expected = {
        Reason.POSITION: (((q < LOW + soft) | (q > HIGH - soft)).any(axis=1), np.ones(robots, dtype=bool)),
        Reason.WORKSPACE: (
            (height < z_min) | (radius > radius_max),
            (np.abs(height - z_min) > 1e-9) & (np.abs(radius - radius_max) > 1e-9),
        ),
        Reason.SINGULARITY: (
            manipulability < singularity,
            np.abs(manipulability - singularity) > 1e-9,
        ),
        Reason.COLLISION: (nearest < MARGINS.collision_m, np.abs(nearest - MARGINS.collision_m) > 1e-4),
    }
    for bit, (refused, clear) in expected.items():
        assert clear.sum() > 0.99 * robots
        assert 10 < refused.sum() < robots - 10, bit
        np.testing.assert_array_equal(((reason & int(bit)) != 0)[clear], refused[clear], err_msg=str(bit))
    assert (reason & ~sum(int(bit) for bit in expected) == 0).all()


@pytest.mark.parametrize("joint", range(N))
@pytest.mark.parametrize("share", [-1.001, -0.999, 0.999, 1.001])
def test_acceleration(joint, share):
    """Of a joint that the acceleration slows down: only together with its speed would it be too fast."""
    qdd = one(joint, share * SPEC.joint_array("qdd_max")[joint])
    slow = point(HOME, one(joint, -0.1 * np.sign(share)), qdd)
    found = reasons(setpoint=slow, ahead=point(), safety=Safety(SPEC, Fleet(SPEC, 2, collisions=True)))
    assert (Reason.ACCELERATION in found) == (abs(share) > 1)


def test_robots_are_checked_independently():
    """Eleven robots, each with another fault, and every verdict is that of its own fault."""
    faults = {
        **{1: Reason.VELOCITY, 2: Reason.POSITION, 5: Reason.TRACKING, 6: Reason.HEAT},
        **{
            4: Reason.TORQUE | Reason.VELOCITY | Reason.ACCELERATION,
            7: Reason.TOOL_SPEED | Reason.ACCELERATION,
            8: Reason.VELOCITY,
        },
        **dict.fromkeys((9, 10), Reason.SINGULARITY | Reason.POSITION),
    }
    robots, straight = 11, one(4, 0.0, HOME)
    q, qd, qdd = np.tile(HOME, (robots, 1)), np.zeros((robots, N)), np.zeros((robots, N))
    q_hat, sent, housing_c, hottest_c = q.copy(), q.copy(), *np.full((2, robots, N), 30.0)
    q[9] = straight
    qd[1, 5], qdd[4, 5] = 4.0, 1000.0
    # Only together: the speed that the acceleration will still add counts, and none of the others'.
    qd[7, 0:3], qdd[7, 1:3] = -1.9, -8.0
    rest = q_hat.copy()
    rest[2, 0], rest[10], sent[5, 3], housing_c[6, 2] = HIGH[0], straight, HOME[3] + 0.2, 95.0
    state = State(
        t=0.0,
        q=q_hat,
        qd=qd,
        q_var=q,
        age=np.zeros(robots),
        nis=q,
        housing_c=housing_c,
        winding_c=q,
        hottest_c=hottest_c,
        current_share=np.ones((robots, N)),
        fault=np.zeros(robots, dtype=np.int64),
    )
    setpoint = Setpoint(q=q, qd=qd, qdd=qdd)
    ahead = Setpoint(q=q_hat, qd=qd * 0, qdd=qdd * 0)
    ahead.qd[8, 3] = 4.0
    verdict = Safety(SPEC, Fleet(SPEC, 2 * robots, collisions=True)).step(
        state, Setpoint(q=sent, qd=qd, qdd=qdd), setpoint, stop_at(ahead)._replace(q_rest=rest)
    )
    assert verdict.reason.tolist() == [int(faults.get(i, 0)) for i in range(robots)]


def test_inputs_are_not_modified():
    setpoint, rest = point(qd=one(0, 9.0)), np.tile(HIGH, (1, 1))
    before = setpoint.q.copy(), setpoint.qd.copy(), rest.copy()
    judge(setpoint=setpoint, q_rest=rest)
    for array, old in zip((setpoint.q, setpoint.qd, rest), before, strict=True):
        np.testing.assert_array_equal(array, old)


def test_joints_that_fail_at_several_points_are_all_named():
    """One at the setpoint, another at the first step of its stop."""
    fast = [one(joint, 10.0) for joint in (1, 4)]
    verdict = judge(setpoint=point(qd=fast[0]), ahead=point(qd=fast[1]))
    failed = SAFETY.failed(verdict, 0, Reason.VELOCITY)
    assert failed["joint_speed"].tolist() == [False, True, False, False, True, False]
    assert SAFETY.failed(judge(), 0, Reason.VELOCITY) == {}


@pytest.mark.parametrize("end", [LOW[2] + MARGINS.q_soft_rad, HIGH[2] - MARGINS.q_soft_rad])
def test_a_value_at_its_bound_has_not_failed(end):
    verdict = judge(
        setpoint=point(one(2, end, HOME)), ahead=point(one(3, 1e3, HOME)), q_hat=HOME, q_rest=HOME
    )
    assert SAFETY.failed(verdict, 0, Reason.POSITION)["joint_angle"].tolist() == [j == 3 for j in range(N)]


def test_poses_without_a_reason():
    assert SAFETY.check_poses(np.tile(HOME, (2, 1))).tolist() == [0, 0]


@pytest.mark.parametrize(("mode", "share"), list(zip(ControlMode, (0.68, 0.68, 0.56), strict=True)))
def test_margins_are_those_of_the_mode(mode, share):
    safety = Safety(SPEC, Fleet(SPEC.in_mode(mode), 2, collisions=True), mode=mode)
    for factor, beyond in ((0.99, False), (1.01, True)):
        fast = point(qd=one(5, factor * share * SPEC.joints[5].qd_max))
        assert bool(judge(safety=safety, setpoint=fast).reason[0] & Reason.VELOCITY) == beyond


def test_shapes_are_named_as_soon_as_they_are_refused():
    """By bisection from the home pose to one that collides."""
    free, colliding = HOME, np.array((0.3, -1.59, 2.64, 0.24, -1.16, 0.87))
    for _ in range(40):
        middle = (free + colliding) / 2
        refused = Reason.COLLISION in reasons(setpoint=point(middle), q_hat=HOME)
        free, colliding = (free, middle) if refused else (middle, colliding)
    assert SAFETY.colliding_shapes(judge(setpoint=point(colliding)), 0) == ("upper_arm", "wrist_3")
    apart = judge(setpoint=point(HOME))
    assert SAFETY.colliding_shapes(apart, 0) == ()
