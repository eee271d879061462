"""Soft drives: poses are checked where joints are sent, and as far from there as joints are now, tools included."""

import numpy as np

from deploy.motion.drive_law import CompliantDrives
from deploy.reasons import Reason
from deploy.safety.safety import Safety
from robots.models.fleet import Fleet
from support.arm6 import SPEC
from support.deploy.safety import HOME, SAFETY, ZERO, N, judge, one, point

FLEET = Fleet(SPEC, 2, collisions=True)
SOFT = Safety(SPEC, FLEET, CompliantDrives(SPEC, FLEET))
LOW, HIGH = SPEC.pose_range


def reasons(safety, q_hat, qd=ZERO):
    """Reasons against a setpoint at home."""
    return Reason(int(judge(safety=safety, q_hat=q_hat, setpoint=point(qd=qd)).reason[0]))


def reach(q):
    """m, of the tool from the axis of the first joint."""
    return np.linalg.norm(FLEET.kinematics(np.stack((q, q))).tool_position[0, :2])


def poses_against_which(wanted):
    """Poses of joints that a check of poses refuses."""
    found = np.random.default_rng(2).uniform(LOW, HIGH, (400, N))
    return [q for q in found if Reason(int(SAFETY.check_poses(np.stack((q, q)))[0])) & wanted][:5]


def test_joints_where_they_are_sent_are_accepted():
    assert reasons(SOFT, HOME) == Reason.NONE


def test_a_pose_as_far_from_the_setpoint_as_joints_are_now_is_refused():
    for wanted in (Reason.COLLISION, Reason.WORKSPACE):
        poses = poses_against_which(wanted)
        assert poses
        for q in poses:
            assert reasons(SOFT, q) & wanted
            assert not reasons(SAFETY, q) & wanted


def test_the_tool_may_be_too_fast_where_joints_are_now():
    """It turns about the shoulder's axis, in a pose that is stretched farther than home."""
    stretched = max(np.random.default_rng(3).uniform(LOW, HIGH, (100, N)), key=reach)
    limit = SPEC.margins.tool_speed * SPEC.workspace.tool_speed_max
    qd = one(0, 0.95 * limit / reach(HOME))
    assert qd[0] * reach(stretched) > limit
    assert reasons(SOFT, stretched, qd) & Reason.TOOL_SPEED
    assert not reasons(SAFETY, stretched, qd) & Reason.TOOL_SPEED
