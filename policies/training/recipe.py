"""Training recipe, read strictly, and the contract that follows from it."""

import os
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, PositiveInt, model_validator

from deploy.policy.compatibility import check_contract, mode_misfit, task_misfit
from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import ONE_LEG, SINES_FIRST, Numbers, Term
from deploy.policy.contract_term import Count as LayerWidth
from deploy.sources.maximum import Scale
from deploy.sources.source import GaitLayout
from deploy.sources.templates import observation_sources, physical_maxima
from deploy.tasks.task import find_task, sources_of
from robots.errors import ConfigError
from robots.models.nominal_model import torque_max
from robots.randomness import SEED_MAX
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_toml

RECIPES = Path(__file__).parents[1]

WEIGHT_MAX = 1e6
"""Largest weight, length or time: far more than a training can use."""
Positive = Annotated[float, Field(gt=0, le=WEIGHT_MAX)]
Penalty = Annotated[float, Field(ge=-WEIGHT_MAX, le=0)]
Count = Annotated[int, Field(ge=1, le=1 << 16)]
"""Number of goals or steps: far more than a training can use."""
Share = Annotated[float, Field(gt=0, le=1)]
HIDDEN_WEIGHTS_MAX = 1 << 24
"""Weights between hidden layers: with as many for the largest observation, half of the largest policy file."""
Robots = Annotated[int, Field(ge=1, le=1 << 14)]
"""Number of robots trained at once; each takes 0.25 MB."""
UNITS_MAX = 1 << 28
"""Steps of a mini-batch times units of all hidden layers: their gradients take 3 GB."""
BATCH_MAX = 1 << 22
"""Steps of all robots between two updates: far more than a training can use; their observations stay in memory."""
ObservationChoice = str | Annotated[tuple[str, ...], Field(min_length=1)]
"""Name of a template, or sources in order."""


class Promise(Strict):
    """Properties of the run time that the policy is trained for.

    Attributes:
        mode: of the action, as in a contract.
        policy_hz: Hz. reach_m: m, what positions are divided by.
        increment_rad: rad of target for a full action. leash_rad: rad of target ahead of the setpoint. Both of
            "position_increment" alone.
        share: of a full action in any other mode: share of half the working range around its middle, of the joint's
            speed limit, or of its torque limit.
        change_share: share of a full action by which the target may change in one policy step; None: any. Not of
            "position_increment", where an action is that change.
    """

    mode: Literal["position_increment", "position", "velocity", "torque"] = "position_increment"
    policy_hz: PositiveInt
    increment_rad: Positive | None = None
    leash_rad: Positive | None = None
    share: Share | None = None
    change_share: Share | None = None
    reach_m: Positive

    @model_validator(mode="after")
    def _fields_of_mode(self) -> Self:
        increments = self.mode == "position_increment"
        needed = {"increment_rad": increments, "leash_rad": increments, "share": not increments}
        for name, meant in needed.items():
            if (found := getattr(self, name)) is not None and not meant:
                raise ValueError(f"promise.{name}: found {found} in mode {self.mode!r}, expected none")
            if found is None and meant:
                raise ValueError(f"promise.{name}: missing in mode {self.mode!r}")
        if increments and self.change_share is not None:
            raise ValueError(
                f"promise.change_share: found {self.change_share} in mode {self.mode!r}, expected none"
            )
        return self


class Gait(Strict):
    """Phase of a gait that the policy observes.

    Attributes:
        period_s: s. phase_offsets: turns by which each leg is ahead. layout: order of sines and cosines.
    """

    period_s: Positive
    phase_offsets: Numbers = ONE_LEG
    layout: GaitLayout = SINES_FIRST


class Environment(Strict):
    """B robots trained at once, and their episodes.

    Attributes:
        goals_per_episode: goals between two resets.
        start_range: share of each joint's working range, around its middle, in which episodes begin; None: at start
            poses of the task. An arm that may bend in two ways learns to change from one to the other only if it is
            shown both.
    """

    robots: Robots
    goals_per_episode: Count
    start_range: Share | None = None


class Reward(Strict):
    """Reward of a policy step, without shaping.

    Attributes:
        success: for a goal reached, at the end of its time.
        joint_limit: a joint beyond its working range; the episode ends.
        near_limit: for each joint beyond `near_share` of its range.
        power: for each W, jerk: for each rad/s³, survival: for each step.
    """

    success: Positive
    joint_limit: Penalty
    near_limit: Penalty
    near_share: Share
    power: Penalty
    jerk: Penalty
    survival: Positive


class Shaping(Strict):
    """Dense shaping reward of a policy step while running.

    Attributes:
        far_m, near_m: m, widths of 1 − tanh(d/width). here_m, here: m and weight of exp(−(d/here_m)²).
        action_change: for each squared unit of action change.
        action_excess: for each squared unit of action beyond its clip: out there exploring changes nothing, so
            nothing would be learned.
        request: for each rad that a target asks beyond the working range.
        singular_below, singular: manipulability below which it costs, and how much it costs at none.
        stop: for a safety stop.
    """

    far_m: Positive
    near_m: Positive
    here_m: Positive
    here: Positive
    action_change: Penalty
    action_excess: Penalty
    request: Penalty
    singular_below: Positive
    singular: Penalty
    stop: Penalty


class LearnerStage(Strict):
    """Iterations at one learning rate."""

    iterations: Count
    learning_rate: Share


def _bounded(hidden: tuple[int, ...]) -> tuple[int, ...]:
    if (weights := sum(a * b for a, b in pairwise(hidden))) > HIDDEN_WEIGHTS_MAX:
        raise ValueError(f"{weights} weights between layers, expected at most {HIDDEN_WEIGHTS_MAX}")
    return hidden


class Learner(Strict):
    """PPO of rsl-rl-lib. Source: Schulman et al. (2017); names as in rsl_rl."""

    stages: Annotated[tuple[LearnerStage, ...], Field(min_length=1)]
    num_steps_per_env: Count
    hidden: Annotated[tuple[LayerWidth, ...], Field(min_length=1, max_length=16), AfterValidator(_bounded)]
    init_std: Positive
    gamma: Share
    lam: Share
    entropy_coef: Annotated[float, Field(ge=0, le=WEIGHT_MAX)]
    num_learning_epochs: Count
    num_mini_batches: Count
    clip_param: Share
    value_loss_coef: Positive
    use_clipped_value_loss: bool
    max_grad_norm: Positive


class Recipe(Strict):
    """All settings of a training.

    Attributes:
        observation: name of a template, or sources in order; None: those of the task.
        gait: given exactly if gait_phase is observed.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    robot: str
    task: str
    seed: Annotated[int, Field(ge=0, le=SEED_MAX)]
    observation: ObservationChoice | None = None
    gait: Gait | None = None
    promise: Promise
    environment: Environment
    reward: Reward
    shaping: Shaping
    learner: Learner

    @model_validator(mode="after")
    def _batch_is_possible(self) -> Self:
        steps = self.environment.robots * self.learner.num_steps_per_env
        if steps > BATCH_MAX:
            raise ValueError(
                f"environment.robots times learner.num_steps_per_env: found {steps}, expected at most {BATCH_MAX}"
            )
        if (batches := self.learner.num_mini_batches) > steps / 2:  # one advantage has no deviation
            raise ValueError(
                f"learner.num_mini_batches: found {batches}, expected at most half of {steps}: "
                "environment.robots times num_steps_per_env"
            )
        if (units := -(-steps // batches) * sum(self.learner.hidden)) > UNITS_MAX:
            raise ValueError(
                f"environment.robots times learner.num_steps_per_env over num_mini_batches, times the sum of hidden: "
                f"found {units}, expected at most {UNITS_MAX}"
            )
        return self


def find_recipe(recipe: str) -> Path:
    """Return the recipe file of a path, or of a name among the shipped recipes.

    Raises:
        ConfigError: neither is there.
    """
    for path in (Path(recipe), RECIPES / f"{recipe}.toml"):
        if os.path.isfile(path):
            return path
    known = ", ".join(sorted(path.stem for path in RECIPES.glob("*.toml")))
    raise ConfigError(f"--recipe {recipe}: no such file, expected a path or one of policies/: {known}")


def load_recipe(path: Path) -> Recipe:
    """Read a recipe.

    Raises:
        ConfigError: unreadable, misspelt or out of bounds.
    """
    return read_toml(path, Recipe, ConfigError)


def contract_of(
    recipe: Recipe, spec: RobotSpec, trained: dict[str, str], file: Path | None = None
) -> Contract:
    """Return the contract of a policy trained by a recipe for its robot.

    Args:
        trained: provenance. file: of the recipe, for errors; None: they name the recipe.

    Raises:
        FirstshiftError: naming file or recipe, and field: task, mode, rate or observation do not fit the robot.
    """
    origin = str(file or f"recipe {recipe.name}")
    _check_fit(recipe, spec, origin)
    fields = {
        "robot": spec.name,
        "robot_digest": spec.digest,
        "joint_names": spec.joint_names,
        "policy_hz": recipe.promise.policy_hz,
        "control_hz": spec.rates.control_hz,
        "task": recipe.task,
        "observation": _terms(recipe, spec, origin),
        "action": _action(recipe.promise, spec),
        "trained": trained,
    }
    contract = parse(fields, Contract, source=f"{origin}: contract")
    check_contract(contract, spec, f"{origin}: contract")
    return contract


def _check_fit(recipe: Recipe, spec: RobotSpec, origin: str) -> None:
    """Refuse (ConfigError) a task that the robot cannot do, and a mode that its drives cannot do."""
    find_task(recipe.task, f"{origin}: task: found {recipe.task!r}")
    if misfit := task_misfit(recipe.task, spec):
        raise ConfigError(f"{origin}: task: {misfit}")
    if misfit := mode_misfit(recipe.promise.mode, spec):
        raise ConfigError(f"{origin}: promise.mode: {misfit}")


def _action(promise: Promise, spec: RobotSpec) -> ActionSpec:
    """Return the meaning of actions in [-1, 1]."""
    low, high = spec.pose_range
    full = {
        "position_increment": np.full(spec.n, promise.increment_rad or 0.0),
        "position": (high - low) / 2 * (promise.share or 0.0),
        "velocity": spec.joint_array("qd_max") * (promise.share or 0.0),
        "torque": torque_max(spec) * (promise.share or 0.0),
    }
    scale, change = full[promise.mode], promise.change_share
    return ActionSpec(
        mode=promise.mode,
        size=spec.n,
        offset=tuple(((high + low) / 2).tolist()) if promise.mode == "position" else None,
        scale=tuple(scale.tolist()),
        clip=(-1.0, 1.0),
        change_max=None if change is None else tuple((change * scale).tolist()),
        leash_rad=promise.leash_rad,
    )


def _terms(recipe: Recipe, spec: RobotSpec, origin: str) -> tuple[Term, ...]:
    """Return terms without clip or history, each divided by its physical maximum."""
    where = f"{origin}: observation"
    task, known = find_task(recipe.task, f"{origin}: task"), sources_of(recipe.task)
    names = observation_sources(recipe.observation or task.observation, known, spec, where, task.command)
    if ("gait_phase" in names) != (recipe.gait is not None):
        found, expected = ("no", "one") if recipe.gait is None else ("a", "none")
        raise ConfigError(f"{where}: found {found} table gait, expected {expected}: {', '.join(names)}")
    leash_rad = np.nan if recipe.promise.leash_rad is None else recipe.promise.leash_rad
    scale = Scale(spec, recipe.promise.reach_m, leash_rad)
    terms = []
    for name in names:
        source, gait = known[name], recipe.gait if name == "gait_phase" else None
        maxima = physical_maxima(name, source, scale, where)
        if gait:
            maxima *= len(gait.phase_offsets)
        terms.append(
            Term(
                name=name,
                source=name,
                frame=source.frame,
                unit=source.unit,
                size=len(maxima),
                scale=maxima,
                **(gait.model_dump() if gait else {}),
            )
        )
    return tuple(terms)
