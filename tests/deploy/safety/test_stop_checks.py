import numpy as np
import pytest

from deploy.motion.drive_law import TorqueDrives
from deploy.motion.drive_modes import position_drives
from deploy.motion.smoother import Smoother
from deploy.motion.trajectories import stop_moments_s
from deploy.reasons import Reason
from deploy.safety.checks import TAKEOVER_RATE
from deploy.safety.safety import Safety
from deploy.state import BRAKING_SHARES, STOP_MOMENTS, Setpoint, State
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC
from support.deploy.safety import (
    FASTER_IN_ITS_STOP,
    HIGH,
    HOME,
    LOW,
    MARGINS,
    SPACE,
    ZERO,
    N,
    one,
    point,
    reasons,
)

MOMENTS = range(STOP_MOMENTS)
"""Numbers of the moments at which a stop is checked."""


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("limit", ["z_min", "radius_max"])
def test_tool_stays_in_the_workspace_during_a_stop(limit, moment):
    """Though where the stop begins and ends is well inside: the arm is let down, or stretched, until it is refused."""
    fleet, reach = Fleet(SPEC, 1), MARGINS.workspace_m
    far = (
        one(1, -0.35, one(2, 1.2, HOME))
        if limit == "z_min"
        else one(1, -2.27, one(2, 0.4, one(3, -2.72, HOME)))
    )
    verdicts = []
    for share in np.linspace(0, 1, 200):
        q = HOME + share * (far - HOME)
        kinematics = fleet.kinematics(q[None])
        (tool,) = kinematics.tool_position
        height, radius = tool[2] - SPACE.z_min, SPACE.radius_max - np.linalg.norm(tool - SPACE.centre)
        found = reasons(braking={moment: point(q)})
        verdicts.append(Reason.WORKSPACE in found)
        assert verdicts[-1] == (min(height, radius) < reach)
        assert found & ~(Reason.WORKSPACE | Reason.COLLISION | Reason.SINGULARITY) == 0
    assert 0 < sum(verdicts) < 200
    assert Reason.NOT_FINITE in reasons(braking={moment: point(np.full(N, np.nan))})


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_stop_through_a_singularity_is_refused(moment):
    """Its ends are on the same side, far from it."""
    assert Reason.SINGULARITY in reasons(braking={moment: point(one(4, 0.0, HOME))})


@pytest.mark.parametrize("moment", MOMENTS)
def test_tool_speed_is_limited_while_a_stop_brakes(moment):
    """One joint turns faster and faster, the others rest: refused exactly where the tool is too fast."""
    kinematics, limit = Fleet(SPEC, 1).kinematics(HOME[None]), SPEC.margins.tool_speed * SPACE.tool_speed_max
    verdicts = []
    for speed in np.linspace(0.0, 10.0, 50):
        qd = one(0, speed)
        found = reasons(braking={moment: point(qd=qd)}) & ~(Reason.VELOCITY | Reason.TORQUE)
        verdicts.append(found == Reason.TOOL_SPEED)
        assert verdicts[-1] == (np.linalg.norm(kinematics.tool_velocity(qd[None])) > limit)
        assert found & ~Reason.TOOL_SPEED == 0
    assert 0 < sum(verdicts) < 50
    assert Reason.NOT_FINITE in reasons(braking={moment: point(qd=np.full(N, np.nan))})


@pytest.mark.parametrize("mode", [ControlMode.POSITION, ControlMode.TORQUE])
def test_a_stop_takes_over_from_torques_at_a_bounded_rate(mode):
    """A wrist's torque is changed up and down until it is refused: not where drives follow angles anyway."""
    fleet, joint = Fleet(SPEC, 2, collisions=True), 4
    safety = Safety(SPEC, fleet, TorqueDrives(SPEC, fleet), mode=mode)
    most = TAKEOVER_RATE * SPEC.joints[joint].torque_mode.rate_max * SPEC.dt
    rest, drive = point(), position_drives(SPEC, 1)._replace(mode=np.array([ControlMode.TORQUE]))
    holding = Fleet(SPEC, 1).torque(rest.q, rest.qd, rest.qdd)
    for change in (-1.01, -0.99, 0.99, 1.01):
        sent_as_torque = rest._replace(tau=holding + one(joint, change * most), drive=drive)
        found = reasons(setpoint=sent_as_torque, ahead=rest, safety=safety)
        refused = mode is ControlMode.TORQUE and abs(change) > 1
        assert found == (Reason.TORQUE if refused else 0)


FLEET = Fleet(SPEC, 2, collisions=True)
QUICK = SPEC.model_copy(
    update={
        "margins": MARGINS.model_copy(update={"speed": 0.7, "collision_m": 0.01}),
        "joints": tuple(
            joint.model_copy(update={"qdd_max": max(qdd, joint.qdd_max)})
            for joint, qdd in zip(SPEC.joints, (10.3, 2.6, 6.0, 0.0, 0.0, 0.0), strict=True)
        ),
    }
)
"""The arm with the margin of speed and the accelerations with which the stops below were found."""
FAST = QUICK.model_copy(update={"margins": MARGINS.model_copy(update={"speed": 0.95, "tool_speed": 0.92})})
"""The arm with a small margin of speed."""


def stop_of(start):
    """What the fast arm's safety is given of a stop but its middle, and the stop."""
    stop, safety = Smoother(FAST, 1).brake(start), Safety(FAST, Fleet(FAST, 2, collisions=True))
    ends = {"setpoint": start, "qd_hat": start.qd, "ahead": stop.ahead, "q_rest": stop.q_rest}
    return ends | {"safety": safety}, stop


@pytest.mark.parametrize("moment", MOMENTS)
def test_speed_of_the_tool_is_that_of_the_moments_own_pose(moment):
    """Its pan turns an arm that reaches out, or one that does not, with the same speed."""
    reaching, pan = one(2, 0.6, one(1, -0.8, HOME)), one(0, 3.0)
    for q, expected in ((reaching, Reason.TOOL_SPEED), (HOME, 0)):
        found = reasons(braking={moment: point(q, pan)}, safety=Safety(SPEC, FLEET))
        assert found & ~Reason.VELOCITY == expected
    braking = {each: point(qd=pan) if each == moment else point(reaching) for each in MOMENTS}
    found = reasons(braking=braking, q_rest=reaching, safety=Safety(SPEC, FLEET))
    assert found & ~Reason.VELOCITY == 0


@pytest.mark.parametrize("moment", MOMENTS)
def test_torque_is_limited_while_a_stop_brakes(moment):
    """An arm that reaches out is lifted ever faster: refused exactly where that takes too much torque."""
    q, verdicts = one(2, 0.6, one(1, -0.8, HOME)), []
    for share in np.linspace(-2.0, 2.0, 41):
        qdd = share * SPEC.joint_array("qdd_max") * (0, 1, 1, 1, 0, 0)
        tau = Fleet(SPEC, 1).torque(q[None], ZERO[None], qdd[None])
        found = reasons(braking={moment: point(q, qdd=qdd)}) & ~Reason.ACCELERATION
        assert found == (Reason.TORQUE if (np.abs(tau) > MARGINS.tau * torque_max(SPEC)).any() else 0)
        verdicts.append(found)
    assert {*verdicts} == {Reason(0), Reason.TORQUE}


@pytest.mark.parametrize("moment", MOMENTS)
def test_speed_and_acceleration_are_limited_while_a_stop_brakes(moment):
    for name, limit, reason in (
        ("qd", MARGINS.speed * SPEC.joint_array("qd_max"), Reason.VELOCITY),
        ("qdd", SPEC.joint_array("qdd_max"), Reason.ACCELERATION),
    ):
        points = (point(**{name: one(5, x * limit[5])}) for x in (0.999, 1.001))
        within, beyond = (reasons(braking={moment: each}) for each in points)
        assert (within, beyond) == (0, reason)


def test_a_stop_in_which_the_tool_gains_speed_is_refused():
    """The last joints brake first, and no longer hold back what the others do."""
    ends, stop = stop_of(point(*FASTER_IN_ITS_STOP))
    assert reasons(**ends) == 0
    assert reasons(**ends, braking={1: point(stop.q[1], stop.qd[1])}) == Reason.TOOL_SPEED


def touching(fleet, q):
    """(B,) where shapes touch, or the tool is outside, at poses (B, n)."""
    kinematics = fleet.kinematics(q, jacobians=False)
    tool = kinematics.tool_position
    return (
        kinematics.colliding
        | (tool[:, 2] < SPACE.z_min)
        | (np.linalg.norm(tool - SPACE.centre, axis=1) > SPACE.radius_max)
    )


@pytest.mark.parametrize("share", [0.5, 0.95])  # of the speed that may be planned
@pytest.mark.slow
def test_allowed_stops_stay_within_all_limits(share):
    """150 stops from up to this share of speed, towards a forbidden place, checked every 20 ms."""
    robots, rng, smoother = 64, np.random.default_rng(3), Smoother(SPEC, 64)
    bare = SPEC.model_copy(update={"margins": MARGINS.model_copy(update={"collision_m": 1e-9})})
    safety = Safety(SPEC, Fleet(SPEC, 2 * robots, collisions=True))
    crowd, starts, blocked = Fleet(bare, 8 * robots, collisions=True), [], 0
    while len(starts) < 150:
        ahead = rng.uniform(LOW, HIGH, (8 * robots, N))
        ahead = ahead[touching(crowd, ahead)][:robots]
        qd = rng.uniform(-share, share, (robots, N)) * MARGINS.speed * SPEC.joint_array("qd_max")
        q = np.clip(ahead - qd * rng.uniform(0.02, 0.2, (robots, 1)), LOW + 0.03, HIGH - 0.03)
        start = Setpoint(q=q, qd=qd, qdd=q * 0)
        here = State(
            t=0.0,
            q=q,
            qd=qd,
            q_var=q * 0,
            age=np.zeros(robots),
            nis=q * 0,
            housing_c=q * 0 + 30,
            winding_c=q * 0 + 30,
            hottest_c=q * 0 + 30,
            current_share=np.ones(q.shape),
            fault=np.zeros(robots, dtype=np.int64),
        )
        fine = safety.step(here, start, start, smoother.brake(start)).reason == 0
        starts.extend(zip(q[fine], qd[fine], strict=True))
        blocked += (~fine).sum()
    assert blocked > len(starts)
    q, qd = (np.array(values) for values in zip(*starts, strict=True))
    fleet, smoother = crowd.resized(len(q)), Smoother(SPEC, len(q))
    smoother.commit(Setpoint(q=q, qd=qd, qdd=q * 0))
    for tick in range(80):
        smoother.commit(smoother.next(q, np.ones(len(q), dtype=bool)))
        if tick % 4 == 0:
            assert not touching(fleet, smoother.q).any()


def test_only_too_fast_stops_are_refused():
    """Stops of one joint from near the limit, at any acceleration, each lived through."""
    robots, rng, smoother = 192, np.random.default_rng(4), Smoother(SPEC, 192)
    qd_max, joint = MARGINS.speed * SPEC.joint_array("qd_max"), np.arange(robots)[:, None] % N == np.arange(N)
    qd = joint * rng.uniform(0.8, 1.05, (robots, N)) * rng.choice([-1, 1], (robots, N)) * qd_max
    qdd = joint * rng.uniform(-1, 1, (robots, N)) * SPEC.joint_array("qdd_max")
    smoother.commit(Setpoint(q=np.tile(HOME, (robots, 1)), qd=qd, qdd=qdd))
    fastest = np.abs(qd)
    for _ in range(25):
        smoother.commit(smoother.next(smoother.q, np.ones(robots, dtype=bool)))
        fastest = np.maximum(fastest, np.abs(smoother.qd))
    share = (fastest / qd_max).max(axis=1)
    refused = np.array(
        [Reason.VELOCITY in reasons(setpoint=point(qd=v, qdd=a)) for v, a in zip(qd, qdd, strict=True)]
    )
    between = np.abs(share - 1) < 1e-3  # the fastest moment lies between two ticks
    np.testing.assert_array_equal((share > 1)[~between], refused[~between])
    gains = share > (np.abs(qd) / qd_max).max(axis=1) + 1e-3
    assert (refused & gains).sum() > 10
    assert (~refused & gains).sum() > 10


WRIST_INTO_TABLE = (
    # Well clear at the start and at the end of a stop; between them the second wrist's link goes through the table.
    (
        (-0.8291, -0.6605, 1.6205, 0.2175, -2.4461, -0.0122),
        (-1.4411, 0.525, -1.787, -2.8404, 0.8444, -1.1059),
    ),
    (
        (0.5961, -0.8644, 2.0836, -0.1791, -0.5568, -1.7993),
        (1.3637, 0.5738, 2.2241, -1.7916, -0.8001, 0.1618),
    ),
)


@pytest.mark.parametrize(("q", "qd"), WRIST_INTO_TABLE)
def test_stop_into_the_table_is_refused(q, qd):
    ends, stop = stop_of(point(np.array(q), np.array(qd)))
    assert reasons(**ends) == 0
    assert reasons(**ends, braking={2: point(stop.q[2])}) == Reason.COLLISION


def test_a_stop_that_dips_after_the_fast_joints_rest_is_refused():
    """Elbow and wrist lower a link while the slower shoulder lifts it: a policy led there, and it hit the table."""
    q = np.array([0.0, -0.909684242, 1.968643348, 0.024736534, -2.152871125, 0.0])
    qd = np.array([0.0, 0.838462428, 2.085953757, -1.818148208, -2.198, 0.0])
    start = point(q, qd, np.array([0.0, 2.6, 6.0, -15.1, 0.0, 0.0]))
    stop, safety = Smoother(QUICK, 1).brake(start), Safety(QUICK, Fleet(QUICK, 2, collisions=True))
    ends = {"setpoint": start, "qd_hat": qd, "ahead": stop.ahead, "q_rest": stop.q_rest, "safety": safety}
    assert reasons(**ends, braking={moment: point(stop.q[moment]) for moment in range(3)}) == 0
    assert reasons(**ends, braking={3: point(stop.q[3])}) == Reason.COLLISION
    assert reasons(**ends, braking={4: point(stop.q[4])}) == Reason.COLLISION


def test_moments_at_which_a_stop_is_checked():
    """Shares of the time v / a + a / j of all joints but the slowest, from half of its speed."""
    qd, qdd, jerk = (SPEC.joint_array(name) for name in ("qd_max", "qdd_max", "qddd_max"))
    times = 0.5 * SPEC.margins.speed * qd / qdd + qdd / jerk
    slowest = times.argmax()
    without = np.delete(times, slowest).max()
    assert without < 0.7 * times[slowest]
    np.testing.assert_allclose(stop_moments_s(SPEC), without * np.array(BRAKING_SHARES))


def test_moments_at_which_the_stop_of_one_joint_is_checked():
    alone = SPEC.model_copy(update={"joints": SPEC.joints[:1]})
    qd, qdd, jerk = (alone.joint_array(name)[0] for name in ("qd_max", "qdd_max", "qddd_max"))
    whole = 0.5 * alone.margins.speed * qd / qdd + qdd / jerk
    np.testing.assert_allclose(stop_moments_s(alone), whole * np.array(BRAKING_SHARES))
