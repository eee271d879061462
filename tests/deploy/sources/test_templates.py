"""Templates and lists of sources, the physical maximum of every number, and the page that lists them all."""

from pathlib import Path

import numpy as np
import pytest

from deploy.sources.catalogue import SOURCES
from deploy.sources.maximum import Maximum, Scale
from deploy.sources.source import ObservationSource
from deploy.sources.templates import TEMPLATES, observation_sources, physical_maxima
from deploy.tasks.task import Task, find_task, installed_sources, sources_of
from robots.errors import ConfigError
from robots.models.nominal_model import torque_max
from robots.spec import load_robot
from support.arm6 import SPEC
from support.paths import ROOT
from support.planar import arm_with_wheel
from support.walking import QUADRUPED

REACH, WALK = sources_of("reach"), sources_of("velocity")
ARM = Scale(SPEC, reach_m=0.85, leash_rad=0.3)


@pytest.mark.parametrize(
    ("template", "numbers"), [("unit_24", 24), ("unit_42", 42), (("joint_position", "joint_sin_cos"), 18)]
)
def test_an_observation_has_the_numbers_of_its_sources(template, numbers):
    names = observation_sources(template, REACH, SPEC, "here", ())
    assert sum(REACH[name].count(SPEC) for name in names) == numbers


def test_the_layout_of_a_planar_arm_is_what_its_task_observes():
    planar, known = load_robot("planar3"), sources_of("planar_reach")
    names = observation_sources("planar_9", known, planar, "here", ())
    assert names == find_task("planar_reach", "here").observation
    assert sum(known[name].count(planar) for name in names) == 9


COMMANDS = {
    "velocity": (("velocity_command", "heading_error"), 3 + 2),
    "waypoint": (("waypoint_direction", "waypoint_distance"), 2 + 1),
}


@pytest.mark.parametrize("task", COMMANDS)
def test_the_egocentric_layout_ends_with_the_command_of_the_task(task):
    (command, numbers), known, spec = COMMANDS[task], sources_of(task), load_robot("quadruped")
    names = observation_sources("egocentric", known, spec, "here", find_task(task, "here").command)
    assert names == (*TEMPLATES["egocentric"].sources, *command)
    assert sum(known[name].count(spec) for name in names) == 3 + 2 + 2 + 12 + 12 + 4 + 1 + numbers


def test_the_egocentric_layout_needs_a_command():
    with pytest.raises(
        ConfigError, match=r"here: found 'egocentric', expected it with a task that has command"
    ):
        observation_sources("egocentric", SOURCES, load_robot("quadruped"), "here", Task.command)


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        ("unit_23", "here: found 'unit_23', expected a list of sources, or one of unit_24, unit_42, "),
        (("joint_position", "elbow"), "here: found 'elbow', expected sources among joint_position, "),
        (("joint_position",) * 2, "here: found 'joint_position' 2 times, expected once"),
        ("planar_9", "here: 'planar_9' has 12 numbers on arm6, expected 9"),
        ("egocentric", "here: base_linear_velocity needs floating_base; arm6 has manipulability"),
        (
            ("goal_distance",),
            "here: goal_distance needs a sensor of kind distance; arm6 has encoder, current",
        ),
    ],
)
def test_an_observation_that_does_not_fit_is_refused(observation, message):
    with pytest.raises(ConfigError) as caught:
        observation_sources(observation, REACH, SPEC, "here", ())
    assert str(caught.value).startswith(message)


def maxima(name, scale=ARM):
    return physical_maxima(name, installed_sources()[name], scale, "here")


def test_maxima_are_physical():
    assert maxima("joint_position") == (1.3, 2.4, 2.65, 3.0, 2.6, 2.9)
    assert maxima("joint_velocity") == (3.14,) * 6
    assert maxima("joint_euler") == (np.pi,) * 18
    assert maxima("joint_rotation_rate") == (3.14,) * 18
    assert maxima("joint_torque") == tuple(torque_max(SPEC))
    assert maxima("motor_current")[0] == pytest.approx(150 / 10.1, rel=0.01)
    assert maxima("motor_temperature") == (90.0,) * 6
    assert maxima("tool_force") == (50.0,) * 3
    assert maxima("tool_position") == maxima("goal_position") == (0.85,) * 3
    assert maxima("goal_torque") == (0.85**2,) * 6
    assert maxima("target_offset") == (0.3,) * 6
    walking = Scale(QUADRUPED, 1.0, 1.0)
    assert maxima("base_height", walking)[0] == pytest.approx(0.33, abs=0.1)
    assert maxima("base_linear_velocity", walking) == (1.0,) * 3
    assert maxima("velocity_command", walking) == (1.0,) * 3  # it only stands
    assert maxima("base_pitch_roll", walking) == (np.pi,) * 2
    assert maxima("gait_phase", walking) == (1.0, 1.0)


@pytest.mark.parametrize("value", [0.0, np.inf, np.nan])
def test_a_maximum_that_cannot_divide_is_refused(value):
    endless = ObservationSource(
        frame="joint",
        unit="rad",
        each="joint",
        sensing="proprioceptive",
        maximum=Maximum("end of the range", lambda scale: value),
        read=lambda runtime: runtime.state.q,
        meaning="angle",
    )
    with pytest.raises(
        ConfigError, match=r"here: x: end of the range: found \[.*, expected finite numbers above 0"
    ):
        physical_maxima("x", endless, ARM, "here")


def test_the_angle_of_a_wheel_has_no_maximum(tmp_path):
    wheel = Scale(load_robot(arm_with_wheel(tmp_path)), reach_m=0.9, leash_rad=0.3)
    with pytest.raises(ConfigError, match=r"joint_position: .*inf\], expected finite numbers above 0"):
        physical_maxima("joint_position", REACH["joint_position"], wheel, "here")
    assert physical_maxima("joint_sin_cos", REACH["joint_sin_cos"], wheel, "here") == (1.0,) * 8


def test_every_source_has_a_maximum_for_every_number():
    """On robots with all that a source needs."""
    for spec, known in ((SPEC, REACH), (QUADRUPED, WALK)):
        for name, source in known.items():
            if not source.missing(spec):
                found = physical_maxima(name, source, Scale(spec, 0.85, 0.3), "here")
                assert len(found) == source.count(spec), name


def recipe_with(text, tmp_path):
    pytest.importorskip("torch")
    from policies.training.recipe import contract_of, find_recipe, load_recipe

    path = tmp_path / "mine.toml"
    path.write_text(find_recipe("arm").read_text().replace("seed = 1\n", f"seed = 1\n{text}\n", 1))
    return contract_of(load_recipe(path), SPEC, {})


def test_a_recipe_names_a_template_or_lists_sources(tmp_path):
    unit = recipe_with('observation = "unit_24"', tmp_path)
    assert [term.source for term in unit.observation] == ["joint_euler", "tool_position", "goal_position"]
    assert unit.observation_size == 24
    assert {number for term in unit.observation for number in term.scale} == {np.pi, 0.85}
    listed = recipe_with('observation = ["goal_torque", "motor_current"]', tmp_path)
    assert [term.source for term in listed.observation] == ["goal_torque", "motor_current"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'observation = "unit"',
            "recipe arm: observation: found 'unit', expected a list of sources, or one of",
        ),
        ("observation = []", "observation"),
        ('observation = ["knee"]', "recipe arm: observation: found 'knee', expected sources among"),
        (
            "gait = { period_s = 0.5 }",
            "recipe arm: observation: found a table gait, expected none: joint_position",
        ),
        (
            'observation = ["goal_distance"]',
            "recipe arm: observation: goal_distance needs a sensor of kind distance",
        ),
        (
            'observation = ["base_height"]',
            "recipe arm: observation: base_height needs floating_base",
        ),
    ],
)
def test_a_recipe_with_a_wrong_observation_is_refused(text, message, tmp_path):
    with pytest.raises(ConfigError, match=message.replace("[", r"\[")):
        recipe_with(text, tmp_path)


def test_a_gait_of_a_recipe_has_period_and_legs(tmp_path):
    pytest.importorskip("torch")
    from policies.training.recipe import contract_of, find_recipe, load_recipe

    text = find_recipe("arm").read_text().replace('task = "reach"', 'task = "velocity"')
    text = text.replace("seed = 1\n", 'seed = 1\nobservation = ["joint_position", "gait_phase"]\n', 1)
    path = tmp_path / "walk.toml"
    path.write_text(text)
    with pytest.raises(
        ConfigError, match=r"observation: found no table gait, expected one: joint_position, gait"
    ):
        contract_of(load_recipe(path), QUADRUPED, {})
    path.write_text(text + "\n[gait]\nperiod_s = 0.5\nphase_offsets = [0.0, 0.5]\nlayout = 'cos_sin'\n")
    contract = contract_of(load_recipe(path), QUADRUPED, {})
    assert (contract.period_s, contract.phase_offsets) == (0.5, (0.0, 0.5))
    assert contract.gait_layout == "cos_sin"
    assert contract.observation[1].size == 4


# ---- the page ----


def cells(*columns):
    return f"| {' | '.join(str(column) for column in columns)} |"


def template_rows():
    for name, template in TEMPLATES.items():
        sources = ", ".join(f"`{source}`" for source in template.sources)
        sources += ", and the command terms of the task" if template.commanded else ""
        yield cells(f"`{name}`", sources, template.size or "as joints and feet")


def source_rows():
    for name, source in installed_sources().items():
        each = "" if source.each == "robot" else f" per {source.each}"
        size = "2 per leg" if name == "gait_phase" else f"{source.size}{each}"
        sensors = ", ".join(source.sensors) if source.sensing != "none" else "–"
        meaning, sense = source.meaning.replace("|", r"\|"), source.sensing.replace("none", "–")
        unit, of = source.unit, source.maximum.meaning
        yield cells(f"`{name}`", meaning, f"`{source.frame}`", unit, size, sensors, sense, of)


def test_the_page_lists_every_source_and_template():
    """Its tables are those of the code; on a failure, copy the rows from here."""
    page = (Path(ROOT) / "docs" / "observation.md").read_text()
    for table in (template_rows(), source_rows()):
        rows = "\n".join(table)
        assert rows in page, f"docs/observation.md lacks these rows:\n{rows}"
    assert set(SOURCES) <= set(installed_sources())
