"""The planar chain against the nominal model, MuJoCo and brute force."""

import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from robots.errors import RobotError
from robots.models.fleet import Fleet
from robots.models.planar_chain import PlanarChain
from robots.spec import ROBOTS, load_robot
from support.arm6 import SPEC
from support.planar import LINK_M, PLANAR3, PLANAR4

CHAIN = PlanarChain.of_robot(PLANAR3)
LOW, HIGH = PLANAR3.joint_array("q_min"), PLANAR3.joint_array("q_max")


def in_plane(angle, radius):
    """(..., 3) m at angles above the x axis."""
    return radius[..., None] * np.stack((np.cos(angle), 0 * angle, np.sin(angle)), axis=-1)


def by_hand(q):
    """The tool of three links: the sum of the links, each at the sum of the angles before it."""
    x = sum(LINK_M * np.cos(q[:, : k + 1].sum(axis=1)) for k in range(3))
    z = sum(LINK_M * np.sin(q[:, : k + 1].sum(axis=1)) for k in range(3))
    return np.stack((x, 0 * x, z), axis=1)


@pytest.mark.parametrize("spec", [PLANAR3, PLANAR4], ids=lambda spec: spec.name)
def test_tool_equals_the_closed_form_in_both_libraries(spec):
    mujoco = pytest.importorskip("mujoco")
    load_mujoco = pytest.importorskip("robots.models.mujoco_model").load_mujoco
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (500, spec.n))
    expected = by_hand(q)
    np.testing.assert_allclose(PlanarChain.of_robot(spec).tool(q), expected, atol=1e-12)
    np.testing.assert_allclose(Fleet(spec, 500).kinematics(q).tool_position, expected, atol=1e-12)
    model = load_mujoco(spec)
    data = mujoco.MjData(model)
    for pose, tool in zip(q, expected, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.site(spec.tool).xpos, tool, atol=1e-12)


def test_a_positive_angle_lifts_the_arm():
    for joint in range(3):
        q = np.zeros((1, 3))
        q[0, joint] = 0.1
        assert CHAIN.tool(q)[0, 2] > 0.02


def test_wrist_rotation_leaves_the_tool_where_it_is():
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (100, 4))
    turned = q + np.array([0.0, 0.0, 0.0, 1.0])
    fleet = Fleet(PLANAR4, 100)
    kinematics, before = fleet.kinematics(turned), fleet.kinematics(q).tool_position
    np.testing.assert_allclose(kinematics.tool_position, before, atol=1e-12)
    assert PlanarChain.of_robot(PLANAR4).joints == (0, 1, 2)


@settings(max_examples=30)
@given(share=st.floats(0.3, 1.0), seed=st.integers(0, 2**32))
def test_what_joints_in_their_range_reach_is_reached(share, seed):
    q = share * np.random.default_rng(seed).uniform(LOW, HIGH, (50, 3))
    # The sweep of the third angle is coarse: a little more range than the pose itself needs.
    assert CHAIN.reaches(CHAIN.tool(q), share * LOW - 0.003, share * HIGH + 0.003).all()


@settings(max_examples=30)
@given(
    middle=st.tuples(*[st.floats(-7.0, 7.0)] * 3),
    half=st.tuples(*[st.floats(0.1, 4.0)] * 3),
    seed=st.integers(0, 2**32),
)
def test_ranges_may_lie_anywhere(middle, half, seed):
    low, high = (np.add(middle, side * np.array(half)) for side in (-1.0, 1.0))
    q = np.random.default_rng(seed).uniform(low, high, (50, 3))
    # Near a folded elbow the second angle changes by more than the steps of the sweep.
    assert CHAIN.reaches(CHAIN.tool(q), low - 0.005, high + 0.005).mean() > 0.9


def test_a_range_beyond_half_a_turn_excludes_what_is_outside_it():
    q = np.array([[0.2, 2 * np.pi - 2, 0.1]])
    low, high = np.array([-0.5, 4.0, -0.2]), np.array([0.5, 4.5, 0.2])
    assert CHAIN.reaches(CHAIN.tool(q), low, high).all()
    other = np.array([0.0, 0.7, 0.0])
    assert not CHAIN.reaches(CHAIN.tool(q), low + other, high + other).any()


@pytest.mark.parametrize("share", [0.5, 0.9, 1.0])
def test_reached_points_equal_those_of_brute_force(share):
    """A grid of poses: one has its tool near a point that is reached, and none well inside one that is not."""
    rng = np.random.default_rng(2)
    goals = in_plane(rng.uniform(-np.pi / 2, np.pi / 2, 1000), rng.uniform(0.1, 1.0, 1000))
    found = CHAIN.reaches(goals, share * LOW, share * HIGH)
    axes = [np.linspace(share * low, share * high, 121) for low, high in zip(LOW, HIGH, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    near = cKDTree(CHAIN.tool(grid)).query(goals)[0]
    # From any pose to the nearest one of the grid each joint turns by half a step at most.
    coarse = share * np.pi / 120 / 2 * (0.9 + 0.6 + 0.3)
    assert (near[found] < coarse).all()
    assert (found | (near > 0)).all()
    assert 0.1 < found.mean() < 0.95
    assert (~found & (near < coarse / 5)).mean() < 0.02  # on the border, which the grid ends at


def test_a_point_out_of_reach_or_on_the_base_is_not_reached():
    goals = in_plane(np.zeros(3), np.array([0.9001, 0.0, 2.0]))
    assert not CHAIN.reaches(goals, LOW, HIGH).any()
    assert CHAIN.reaches(in_plane(np.zeros(1), np.array([0.8999])), LOW, HIGH).all()


def test_a_robot_that_is_not_planar_is_refused():
    with pytest.raises(
        RobotError, match=r"arm6/model\.xml: expected 3 parallel hinges .* found 2 parallel to"
    ):
        PlanarChain.of_robot(SPEC)


def edited(folder, robot, old, new):
    """A planar robot with a change of its model."""
    path = shutil.copytree(ROBOTS / robot, folder / robot) / "model.xml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return load_robot(path.parent)


def test_a_chain_that_another_joint_moves_is_refused(tmp_path):
    """A tool beside the axis of the wrist rotation turns around it."""
    site = '<site name="tool" pos="0.2 {} 0"'
    with pytest.raises(RobotError, match="found others that move the tool 'tool'"):
        PlanarChain.of_robot(edited(tmp_path, "planar4", site.format("0"), site.format("0.01")))


@pytest.mark.parametrize("place", ["0 0 0", "0 0.1 0"])
def test_a_chain_whose_first_link_has_no_length_is_refused(tmp_path, place):
    body = '<body name="segment_2" pos="{}"'
    with pytest.raises(RobotError, match=r"hinges .* in a plane; found shoulder and elbow on one axis$"):
        PlanarChain.of_robot(edited(tmp_path, "planar3", body.format("0.3 0 0"), body.format(place)))


def test_a_chain_too_long_for_a_float_is_refused(tmp_path):
    with pytest.raises(RobotError, match="found others that move the tool 'tool', or turned axes"):
        PlanarChain.of_robot(edited(tmp_path, "planar3", 'name="tool" pos="0.3', 'name="tool" pos="1e300'))


@pytest.mark.parametrize("body", ["segment_3", "tool"])
def test_other_links_may_have_no_length(tmp_path, body):
    place = f'name="{body}" pos="{{}} 0 0"'
    chain = PlanarChain.of_robot(edited(tmp_path, "planar3", place.format("0.3"), place.format("0")))
    q = np.random.default_rng(3).uniform(LOW, HIGH, (50, 3))
    assert chain.reaches(chain.tool(q), LOW - 0.003, HIGH + 0.003).all()
