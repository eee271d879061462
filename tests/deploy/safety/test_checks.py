"""A safety check is one named row: added from outside, chosen by capability, refused where it does not fit."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.reasons import Reason
from deploy.safety.check import Check, Limits
from deploy.safety.check_table import CheckTable
from deploy.safety.checks import CHECKS, GIVES_WAY
from deploy.safety.safety import Safety
from deploy.state import STOP_MOMENTS
from robots.models.fleet import Fleet
from robots.spec import load_robot
from support.arm6 import NO_CLEARANCE, SPEC, copy_of_arm
from support.deploy.safety import HOME, judge, point
from support.paths import TEST_ROBOTS
from support.planar import PLANAR3

FENCE = Check(
    name="fence",
    value=lambda pose: pose.kinematics.tool_position[:, 1:2],
    low=-0.3,
    reason=Reason.WORKSPACE,
    needs=frozenset({"tool"}),
)
"""A plane that the tool must not pass, to the right of the arm."""


QUADRUPED = load_robot("quadruped")
OF_WALKERS = {
    "base_tilt",
    "base_height",
    "base_descent",
    "joint_gives_way",
    "joint_runs_away",
    "self_collision_ahead",
}
OF_JOINTS = {"estimated_joint_angle", "estimated_joint_speed", "joint_gives_way", "joint_runs_away"}


def walker_reasons(q, qd):
    """Reasons of the checks of the quadruped's joints."""
    checks = [check for check in CHECKS.estimate if check.name in OF_JOINTS]
    table = CheckTable(1, Limits(QUADRUPED, np.zeros(QUADRUPED.n)), checks)
    state = SimpleNamespace(q=q[None], qd=qd[None])
    found = table.reasons(table.values(SimpleNamespace(state=state, q_soon=state.q)))
    return Reason(0 if found is None else int(found[0]))


def arm(spec=SPEC, **more):
    checks = CHECKS._replace(**{table: (*getattr(CHECKS, table), check) for table, check in more.items()})
    return Safety(spec, Fleet(spec, 2, collisions=True), checks=checks)


@pytest.mark.parametrize("moment", ["setpoint", *range(STOP_MOMENTS), "q_rest"])
def test_a_check_from_outside_is_made_like_any_other(moment):
    safety, right = arm(poses=FENCE), HOME + np.eye(SPEC.n)[0]
    assert judge(safety=safety).reason[0] == 0
    there = {moment: right if moment == "q_rest" else point(right)}
    verdict = judge(
        safety=safety, q_hat=HOME, **(there if moment in ("setpoint", "q_rest") else {"braking": there})
    )
    assert Reason(int(verdict.reason[0])) & Reason.WORKSPACE
    assert set(safety.failed(verdict, 0, Reason.WORKSPACE)) == {"fence"}
    assert safety.names(Reason.WORKSPACE) == {"tool_height", "tool_radius", "fence"}


def test_a_robot_without_a_workspace_has_its_poses_checked():
    safety = Safety(PLANAR3, Fleet(PLANAR3, 2, collisions=True))
    assert safety.check_poses(np.array([[0.0, 0.5, 0.0], [0.0, 1.6, 0.0]])).tolist() == [0, Reason.POSITION]


@pytest.mark.parametrize(("angle", "falls"), [(0.99, False), (1.01, True)])
@pytest.mark.parametrize("toward", [-1.0, 1.0])
def test_a_joint_of_a_walker_that_will_be_beyond_its_soft_range_means_a_fall(angle, falls, toward):
    """By half of the soft margin."""
    low, high = QUADRUPED.pose_range
    bound = (high - low) / 2 - (1 - GIVES_WAY) * QUADRUPED.margins.q_soft_rad
    found = walker_reasons((low + high) / 2 + toward * angle * bound, np.zeros(12))
    assert found == (Reason.FALLEN if falls else Reason.NONE)


@pytest.mark.parametrize(("qd", "way"), [(0.3, None), (-0.3, None), (3.0, 0.06), (-3.0, -0.06)])
def test_where_a_joint_is_soon_is_bounded_by_its_braking_distance(qd, way):
    """A setpoint that brakes in time at the end of its range is no fall."""
    way = np.sign(qd) * qd**2 / (2.0 * SPEC.joints[0].qdd_max) if way is None else way
    end = HOME[0] + way
    for hair, falls in ((1e-9, False), (-1e-9, True)):
        wall = {"high": end + hair} if qd > 0 else {"low": end - hair}
        soon = Check(name="soon", value=lambda estimate: estimate.q_soon[:, :1], reason=Reason.FALLEN, **wall)
        found = judge(safety=arm(estimate=soon), qd_hat=np.eye(SPEC.n)[0] * qd)
        assert (Reason.FALLEN in Reason(int(found.reason[0]))) == falls


@pytest.mark.parametrize(("share", "falls"), [(0.99, False), (1.01, True)])
def test_a_joint_of_a_walker_that_is_faster_than_setpoints_may_be_means_a_fall(share, falls):
    bound = (1 + QUADRUPED.margins.speed) / 2 * QUADRUPED.joint_array("qd_max")
    for qd in (share * bound, -share * bound):
        assert walker_reasons(np.mean(QUADRUPED.pose_range, axis=0), qd) == (
            Reason.FALLEN if falls else Reason.NONE
        )


@pytest.mark.parametrize(
    ("name", "share", "falls"),
    [
        ("base_descent", -5.0, False),
        ("base_descent", 0.99, False),
        ("base_descent", 1.01, True),
        ("base_tilt", 0.99, False),
        ("base_tilt", 1.01, True),
        ("base_height", 1.01, False),
        ("base_height", 0.99, True),
    ],
)
def test_a_walker_that_comes_down_too_fast_tilts_too_far_or_is_too_low_falls(name, share, falls):
    check = next(check for check in CHECKS.estimate if check.name == name)
    table = CheckTable(1, Limits(QUADRUPED, np.zeros(QUADRUPED.n)), [check])
    limits = QUADRUPED.base
    tilt = share * limits.tilt_max_rad
    base = SimpleNamespace(
        velocity_in_world=np.array([[9.0, -9.0, -share * limits.descent_max]]),
        gravity=np.array([[np.sin(tilt), 0.0, -np.cos(tilt)]]),
        height=np.array([share * limits.height_min_m]),
    )
    found = table.reasons(table.values(SimpleNamespace(state=SimpleNamespace(base=base))))
    assert found == (Reason.FALLEN if falls else None)


def test_a_check_may_need_all_that_a_robot_has():
    safety = arm(poses=replace(FENCE, needs=SPEC.capabilities))
    assert "fence" in safety.names(Reason.WORKSPACE)


def test_robots_have_the_checks_whose_needs_they_meet(tmp_path):
    bare = load_robot(copy_of_arm(tmp_path, toml=[("singularity = 0.0005", ""), *NO_CLEARANCE]))
    walker = load_robot(TEST_ROBOTS / "quadruped")
    for spec, missing in (
        (SPEC, OF_WALKERS),
        (bare, OF_WALKERS | {"manipulability", "self_collision"}),
        (walker, {"manipulability", "tool_height", "tool_radius", "tool_speed"}),
    ):
        checks = CHECKS._replace(takeover=())  # of robots in torque mode
        table = CheckTable(2, Limits(spec, np.zeros(spec.n)), *checks)
        every = {check.name for group in checks for check in group}
        assert every - {check.name for check in table.checks} == missing
    assert judge(safety=arm(bare)).reason[0] == 0


@pytest.mark.parametrize(
    ("per_joint", "expected"), [(False, r"found shape \(1, 6\), expected \(1, 1\)"), (True, None)]
)
def test_a_reader_of_the_wrong_width_fails_at_its_first_use(per_joint, expected):
    check = Check(
        name="own_angle",
        value=lambda estimate: estimate.state.q,
        reason=Reason.OUTSIDE,
        per_joint=per_joint,
    )
    safety = arm(estimate=check)
    if expected is None:
        assert judge(safety=safety).reason[0] == 0
        return
    with pytest.raises(ValueError, match=rf"safety check own_angle: value: {expected}"):
        judge(safety=safety)


def test_a_bound_of_the_wrong_width_fails_at_construction():
    check = Check(
        name="own", value=lambda estimate: estimate.state.q, high=np.zeros(2), reason=Reason.OUTSIDE
    )
    with pytest.raises(ValueError, match=r"safety check own: high: found shape \(2,\), expected a number or"):
        arm(estimate=check)


def test_a_name_is_given_once():
    with pytest.raises(ValueError, match="tool_height, tool_radius, tool_height, expected each once"):
        arm(poses=next(check for check in CHECKS.poses if check.name == "tool_height"))


def test_rows_may_stand_in_any_order():
    """The same verdicts come from reversed tables."""
    fleet, rng = Fleet(SPEC, 2, collisions=True), np.random.default_rng(0)
    ordered, turned = (
        Safety(SPEC, fleet, checks=type(CHECKS)(*(table[::order] for table in CHECKS))) for order in (1, -1)
    )
    for _ in range(50):
        wild = point(HOME + rng.normal(size=SPEC.n), rng.normal(size=SPEC.n), 20 * rng.normal(size=SPEC.n))
        ours, theirs = judge(safety=ordered, setpoint=wild), judge(safety=turned, setpoint=wild)
        assert ours.reason.tolist() == theirs.reason.tolist()
        for reason in Reason(int(ours.reason[0])):
            found, expected = (
                safety.failed(verdict, 0, reason) for safety, verdict in ((turned, theirs), (ordered, ours))
            )
            assert {name: joints.tolist() for name, joints in found.items()} == {
                name: joints.tolist() for name, joints in expected.items()
            }
