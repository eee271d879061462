"""Sources of a floating base, against closed forms and against the ground truth of exact robots that stand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deploy.sources.floating_base import pitch_roll, pitch_roll_rate
from deploy.sources.templates import TEMPLATES
from robots.models.fleet import Fleet
from robots.spec import load_robot
from support.contracts import term
from support.deploy.exact_robots import exact_runtime, observe
from support.walking import CONTACT_SENSORS, QUADRUPED, changed, walking_contract

SOURCES = (
    *TEMPLATES["egocentric"].sources,
    *(
        "velocity_command",
        "base_linear_acceleration",
        "foot_force",
        "gait_phase",
        "heading_error",
        "base_angular_velocity",
    ),
)
LEGS = (0.0, 0.5, 0.5, 0.25)
FOOT_M = 0.02
"""Radius of a foot: its frame is in the middle."""
MASS_KG = 12.04
NOISE = {"sensors.noise": 0.5}
"""An IMU without any counts as stuck."""


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """An exact robot with contact sensors, on its feet for a second, and what it then observed."""
    spec = load_robot(changed(tmp_path_factory.mktemp("feet"), CONTACT_SENSORS))
    gait = {"gait_phase": {"period_s": 0.4, "phase_offsets": LEGS}}
    runtime = exact_runtime(spec, lambda **f: walking_contract(spec, **f), SOURCES, NOISE, **gait)
    observe(runtime, 25)
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    return runtime, observe(runtime, 100)


def test_pitch_and_roll_rebuild_gravity():
    R = Rotation.random(300, rng=np.random.default_rng(0))
    yaw, pitch, roll = R.as_euler("ZYX").T
    found = pitch_roll(R.inv().apply([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(found, np.stack((pitch, roll), axis=1), atol=1e-9)
    assert np.abs(yaw).max() > 3.0


def test_pitch_and_roll_rates_are_their_derivatives():
    rng, dt = np.random.default_rng(1), 1e-6
    R = Rotation.from_euler("ZYX", rng.uniform((-3, -1, -1.2), (3, 1, 1.2), (200, 3)))
    turning = rng.normal(size=(200, 3))
    after = R * Rotation.from_rotvec(turning * dt)
    down = np.array([0.0, 0.0, -1.0])
    change = pitch_roll(after.inv().apply(down)) - pitch_roll(R.inv().apply(down))
    np.testing.assert_allclose(pitch_roll_rate(R.inv().apply(down), turning), change / dt, atol=1e-4)


def test_a_base_on_its_nose_has_finite_rates():
    assert np.isfinite(pitch_roll_rate(np.array([[1.0, 0.0, 0.0]]), np.ones((1, 3)))).all()


def test_egocentric_readings_of_a_standing_robot(standing):
    runtime, seen = standing
    base = runtime.robot.truth().base
    assert seen["base_height"][0] == pytest.approx(base.position[0, 2] - FOOT_M, abs=0.003)
    yaw_pitch_roll = Rotation.from_quat(base.quat_wxyz, scalar_first=True).as_euler("ZYX")
    np.testing.assert_allclose(seen["base_pitch_roll"], yaw_pitch_roll[:, 1:], atol=0.01)
    np.testing.assert_allclose(seen["base_pitch_roll_rate"], 0.0, atol=0.05)
    np.testing.assert_allclose(seen["base_linear_velocity"], base.velocity, atol=0.03)
    np.testing.assert_allclose(seen["base_linear_acceleration"], [[0.0, 0.0, 9.81]], atol=0.3)


def test_height_needs_no_contact_sensors():
    runtime = exact_runtime(QUADRUPED, walking_contract, ("base_height",), NOISE)
    observe(runtime, 25)
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    found, base = observe(runtime, 100)["base_height"], runtime.robot.truth().base
    assert found[0] == pytest.approx(base.position[0, 2] - FOOT_M, abs=0.003)


def test_height_of_a_flying_robot_is_that_above_its_lowest_foot(standing):
    runtime, _ = standing
    feet = runtime.capabilities.by_name["floating_base"]
    bent = QUADRUPED.joint_array("q_home").copy()
    bent[2::3] -= 0.5  # knees up, but one
    bent[2] += 0.5
    sample = {"contact": runtime.sample["contact"]._replace(value=np.zeros((1, 4)))}
    state = runtime.state._replace(q=bent[None])
    position = Fleet(runtime.spec, 1).kinematics(bent[None]).feet_position
    assert feet.height(sample, state)[0, 0] == pytest.approx(-position[0, :, 2].min(), abs=0.01)


def test_feet_that_stand_are_in_contact_and_carry_the_weight(standing):
    runtime, seen = standing
    assert seen["foot_contact"].tolist() == [[1.0] * 4]
    assert seen["foot_force"].sum() == pytest.approx(MASS_KG * 9.81, rel=0.1)
    sample = runtime.sample["contact"]
    runtime.sample = {"contact": sample._replace(value=np.array([[9.9, 10.1, np.nan, 50.0]]))}
    readers = {name: source.reader(runtime) for name, source in sources().items()}
    assert readers["foot_contact"]().tolist() == [[0.0, 1.0, 0.0, 1.0]]
    assert readers["foot_force"]().tolist() == [[9.9, 10.1, 0.0, 50.0]]


def sources():
    from deploy.tasks.task import sources_of

    return {name: sources_of("velocity")[name] for name in ("foot_contact", "foot_force")}


def test_gait_phase_of_four_legs(standing):
    runtime, _ = standing
    seen = observe(runtime)["gait_phase"]
    # The last observation was made `decimation` ticks before the present one.
    t = (runtime.ticks_since_arming[0] - runtime.decimation) * runtime.spec.dt
    phase = 2 * np.pi * (t / 0.4 + np.array(LEGS))
    np.testing.assert_allclose(seen[0], np.concatenate((np.sin(phase), np.cos(phase))), atol=1e-5)


LAYOUTS = {
    "sin_cos": lambda s, c: np.concatenate((s, c)),
    "cos_sin": lambda s, c: np.concatenate((c, s)),
    "by_leg": lambda s, c: np.array([number for leg in zip(s, c, strict=True) for number in leg]),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_gait_is_read_in_its_layout(layout):
    gait = {"gait_phase": {"period_s": 0.4, "phase_offsets": LEGS, "layout": layout}}
    runtime = exact_runtime(
        QUADRUPED, lambda **f: walking_contract(QUADRUPED, **f), ("gait_phase",), NOISE, **gait
    )
    observe(runtime, 25)
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    seen = observe(runtime, 7)["gait_phase"]
    t = (runtime.ticks_since_arming[0] - runtime.decimation) * runtime.spec.dt
    phase = 2 * np.pi * (t / 0.4 + np.array(LEGS))
    np.testing.assert_allclose(seen[0], LAYOUTS[layout](np.sin(phase), np.cos(phase)), atol=1e-5)


def test_a_layout_belongs_to_the_gait():
    with pytest.raises(ValueError, match=r"layout: found 'by_leg', expected it of gait_phase alone"):
        term("joint_position", 12, layout="by_leg")
    one, other = term("gait_phase", 2), term("gait_phase", 2, layout="cos_sin", name="other")
    with pytest.raises(
        ValueError, match=r"layout: found \['cos_sin', 'sin_cos'\], expected the same for all"
    ):
        walking_contract(observation=(one, other))
    assert walking_contract(observation=(other,)).gait_layout == "cos_sin"
    assert "layout" not in one.model_dump_json()


def test_heading_error_turns_with_the_commanded_rate(standing):
    """A robot that stands while it is told to turn falls behind by rate times time."""
    runtime, _ = standing
    rate = 0.6
    runtime.task.goal[:, 2] = rate
    runtime.task.reset(np.ones(1, dtype=bool))
    runtime.task.goal[:, 2] = rate
    for _ in range(20):
        seen = observe(runtime)["heading_error"]
        t = (runtime.task.elapsed[0] - runtime.decimation) * runtime.spec.dt
        assert np.arctan2(*seen[0]) == pytest.approx(rate * t, abs=0.01)
    assert rate * t > 0.2


def test_phase_offsets_belong_to_the_gait():
    with pytest.raises(ValueError, match=r"phase_offsets: found \[0\.5\], expected them of gait_phase"):
        term("joint_position", 12, phase_offsets=(0.5,))
    one, other = term("gait_phase", 2), term("gait_phase", 4, phase_offsets=(0.0, 0.5), name="both")
    with pytest.raises(
        ValueError, match=r"phase_offsets: found \[\(0\.0,\), \(0\.0, 0\.5\)\], expected the same"
    ):
        walking_contract(observation=(one, other))
    assert walking_contract(observation=(other.model_copy(update={"period_s": 0.8}),)).phase_offsets == (
        0.0,
        0.5,
    )
    assert "phase_offsets" not in one.model_dump_json()
