"""Settings of an environment, from its robot, task and control mode and from the options that a user gives."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pydantic import PositiveInt

from deploy.policy.contract import Contract
from deploy.policy.contract_action import MODES
from deploy.sources.templates import observation_sources
from deploy.tasks.task import find_task, sources_of, tasks_of
from policies.training.recipe import (
    RECIPES,
    ObservationChoice,
    Promise,
    Recipe,
    contract_of,
    find_recipe,
    load_recipe,
)
from robots.errors import ConfigError
from robots.spec import RobotSpec, load_robot
from robots.strict import Strict, parse

RenderMode = Literal["human", "rgb_array"]
POLICY_HZ_MAX = 50
"""Hz of policies without a recipe of their own, if the control rate is a multiple of it."""
TEMPLATE = "arm"
"""Recipe of environments without a recipe of their own."""


class Options(Strict):
    """Options of an environment.

    Attributes:
        robot: a name in robots/ or the path of a folder. task: an installed one.
        mode: control mode of the drives.
        recipe: a name in policies/ or a path; None: the shipped one of this robot, task and mode, or else the template.
        observation: name of a template, or sources in order; None: those of the recipe.
        threads: for physics; results do not depend on it.
        render_mode: as in Gymnasium.
    """

    robot: str
    task: str
    mode: str
    recipe: str | None = None
    observation: ObservationChoice | None = None
    threads: PositiveInt = 1
    render_mode: RenderMode | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of an environment.

    Attributes:
        contract: of the policies that are trained in it.
    """

    spec: RobotSpec
    recipe: Recipe
    contract: Contract
    threads: int
    render_mode: RenderMode | None


def read_settings(options: Mapping[str, object], *, goal: bool) -> Settings:
    """Check options and load what they name.

    Args:
        goal: leave observation terms out that depend on the goal, and give each episode one goal.

    Raises:
        FirstshiftError: naming the option, what was found and what was expected.
    """
    if unknown := sorted(options.keys() - Options.model_fields.keys()):
        known = ", ".join(Options.model_fields)
        raise ConfigError(f"option {unknown[0]}: found {options[unknown[0]]!r}, expected one of {known}")
    chosen = parse(dict(options), Options, source="option")
    spec = load_robot(chosen.robot)
    recipe = _recipe(spec, chosen)
    if chosen.observation is not None:
        recipe = _observing(recipe, chosen.observation, spec)
    contract = contract_of(recipe, spec, {})
    if goal:
        _check_hindsight(recipe.task, spec)
        recipe, contract = _one_goal(recipe), _without_goal(contract)
    return Settings(
        spec=spec,
        recipe=recipe,
        contract=contract,
        threads=chosen.threads,
        render_mode=chosen.render_mode,
    )


def hindsight(task: str, spec: RobotSpec) -> bool:
    """Return whether one step tells if a goal is reached, so that other goals can take its place afterwards."""
    return not find_task(task, "option task").success_criterion(spec).mean


def _check_hindsight(task: str, spec: RobotSpec) -> None:
    if not hindsight(task, spec):
        raise ConfigError(
            f"option task: found {task!r}, whose goals count by the mean of their period, expected for -goal ids a task"
            " whose goals count by where a step ends"
        )


def modes_of(spec: RobotSpec) -> tuple[str, ...]:
    """Return the control modes that the drives of a robot can do."""
    return tuple(mode.name.lower() for mode in spec.control_modes)


def _recipe(spec: RobotSpec, chosen: Options) -> Recipe:
    """Return the recipe of the options, which must be for their robot, task and mode."""
    _check(f"task: {spec.name}", chosen.task, tasks_of(spec))
    _check(f"mode: drives of {spec.name}", chosen.mode, modes_of(spec))
    if chosen.recipe is None:
        return shipped_recipe(spec, chosen.task, chosen.mode) or _from_template(
            spec, chosen.task, chosen.mode
        )
    recipe = load_recipe(find_recipe(chosen.recipe))
    for name, expected in {"robot": spec.name, "task": chosen.task, "mode": chosen.mode}.items():
        _check(f"recipe: {chosen.recipe}: {name}", _subject(recipe)[name], (expected,))
    return recipe


def _check(field: str, found: str, known: tuple[str, ...]) -> None:
    if found not in known:
        raise ConfigError(f"option {field}: found {found!r}, expected {' or '.join(known) or 'none'}")


def _subject(recipe: Recipe) -> dict[str, str]:
    mode = MODES[recipe.promise.mode].name.lower()
    return {"robot": recipe.robot, "task": recipe.task, "mode": mode}


def shipped_recipe(spec: RobotSpec, task: str, mode: str) -> Recipe | None:
    """Return the first of the shipped recipes for a robot, task and mode; None: there is none."""
    wanted = {"robot": spec.name, "task": task, "mode": mode}
    recipes = (load_recipe(path) for path in sorted(RECIPES.glob("*.toml")))
    return next((recipe for recipe in recipes if _subject(recipe) == wanted), None)


def _from_template(spec: RobotSpec, task: str, mode: str) -> Recipe:
    template, rate = load_recipe(find_recipe(TEMPLATE)), spec.rates.control_hz
    policy_hz = next(hz for hz in range(min(POLICY_HZ_MAX, rate), 0, -1) if rate % hz == 0)
    promise, observation = {**dict(template.promise), "policy_hz": policy_hz}, None
    if mode != "position":
        promise |= {"mode": mode, "increment_rad": None, "leash_rad": None, "share": 1.0}
        # A target that is no angle has no offset from the joint.
        sources = find_task(task, "option task").observation
        observation = tuple(source for source in sources if source != "target_offset")
    subject = {"name": f"{spec.name}-{task}-{mode}", "robot": spec.name, "task": task}
    changes = {"promise": Promise.model_validate(promise), "observation": observation}
    return template.model_copy(update={**subject, **changes})


def _observing(recipe: Recipe, observation: ObservationChoice, spec: RobotSpec) -> Recipe:
    """Return the recipe with another observation; its gait is left out where it is not observed."""
    command, known = find_task(recipe.task, "option task").command, sources_of(recipe.task)
    names = observation_sources(observation, known, spec, "option observation", command)
    gait = recipe.gait if "gait_phase" in names else None
    return recipe.model_copy(update={"observation": observation, "gait": gait})


def _one_goal(recipe: Recipe) -> Recipe:
    one = recipe.environment.model_copy(update={"goals_per_episode": 1})
    return recipe.model_copy(update={"environment": one})


def _without_goal(contract: Contract) -> Contract:
    """Leave out the task's own sources: they depend on its goal, which hindsight replaces."""
    own = find_task(contract.task, "contract: task").sources
    terms = tuple(term for term in contract.observation if term.source not in own)
    if not terms:
        found = ", ".join(term.source for term in contract.observation)
        raise ConfigError(
            f"option observation: found only {found}, which depend on the goal, expected others for -goal ids"
        )
    return contract.model_copy(update={"observation": terms})
