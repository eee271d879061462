"""How a policy is taught: a recipe file, read strictly, and the contract that follows from it."""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt

from deploy.contract import FRAME_AND_UNIT, ActionSpec, Contract, Source, Term
from robots.errors import ConfigError
from robots.spec import RobotSpec
from robots.strict import Strict, read_toml

RECIPES = Path(__file__).parent

Penalty = Annotated[float, Field(le=0)]
Share = Annotated[float, Field(gt=0, le=1)]


class Promise(Strict):
    """What the policy is promised at run time.

    Attributes:
        policy_hz: Hz. increment_rad: rad of target for a full action. leash_rad: rad of target ahead of the setpoint.
        reach_m: m, what positions are divided by.
    """

    policy_hz: PositiveInt
    increment_rad: PositiveFloat
    leash_rad: PositiveFloat
    reach_m: PositiveFloat


class Environment(Strict):
    """B robots taught at once, and the goals between two resets."""

    robots: PositiveInt
    goals_per_episode: PositiveInt


class Reward(Strict):
    """The reward proper, for each policy step.

    Attributes:
        success: for a goal reached, at the end of its time.
        joint_limit: a joint beyond its working range; the episode ends.
        near_limit: for each joint beyond `near_share` of its range.
        power: for each W, jerk: for each rad/s³, survival: for each step.
    """

    success: PositiveFloat
    joint_limit: Penalty
    near_limit: Penalty
    near_share: Share
    power: Penalty
    jerk: Penalty
    survival: PositiveFloat


class Shaping(Strict):
    """Dense help towards the reward, for each policy step while running.

    Attributes:
        far_m, near_m: m, widths of 1 − tanh(d/width). here_m, here: m and weight of exp(−(d/here_m)²).
        action_change: for each squared unit of action change.
        request: for each rad that a target asks beyond the working range.
        stop: for a safety stop.
    """

    far_m: PositiveFloat
    near_m: PositiveFloat
    here_m: PositiveFloat
    here: PositiveFloat
    action_change: Penalty
    request: Penalty
    stop: Penalty


class Learner(Strict):
    """PPO of rsl-rl-lib. Source: Schulman et al. (2017); names as in rsl_rl."""

    iterations: PositiveInt
    num_steps_per_env: PositiveInt
    hidden: tuple[PositiveInt, ...]
    init_std: PositiveFloat
    gamma: Share
    lam: Share
    learning_rate: PositiveFloat
    desired_kl: PositiveFloat
    entropy_coef: Annotated[float, Field(ge=0)]
    num_learning_epochs: PositiveInt
    num_mini_batches: PositiveInt


class Recipe(Strict):
    """Everything that makes a checkpoint."""

    robot: str
    task: str
    seed: Annotated[int, Field(ge=0)]
    promise: Promise
    environment: Environment
    reward: Reward
    shaping: Shaping
    learner: Learner


def load_recipe(recipe: str | Path) -> Recipe:
    """Read a recipe by its name in `policies/` or by its path.

    Raises:
        ConfigError: unreadable, misspelt or out of bounds.
    """
    path = Path(recipe)
    if not path.is_file():
        path = RECIPES / f"{recipe}.toml"
    return read_toml(path, Recipe, ConfigError)


def contract_of(recipe: Recipe, spec: RobotSpec, trained: dict[str, str]) -> Contract:
    """The contract that a policy of this recipe signs.

    Args:
        recipe: the recipe.
        spec: its robot.
        trained: provenance.
    """
    n, promise = spec.n, recipe.promise
    range_max = np.maximum(np.abs(spec.joint_array("q_min")), np.abs(spec.joint_array("q_max")))
    return Contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        policy_hz=promise.policy_hz,
        control_hz=spec.rates.control_hz,
        task=recipe.task,
        observation=(
            _term("joint_position", range_max.tolist()),
            _term("joint_velocity", spec.joint_array("qd_max").tolist()),
            _term("tool_position", [promise.reach_m] * 3),
            _term("goal_from_tool", [promise.reach_m] * 3),
            _term("last_action", [1.0] * n),
        ),
        action=ActionSpec(
            mode="position_increment",
            size=n,
            scale=(promise.increment_rad,) * n,
            clip=(-1.0, 1.0),
            leash_rad=promise.leash_rad,
        ),
        trained=trained,
    )


def _term(source: Source, scale: list[float]) -> Term:
    """A term without clip or history, divided by its physical maximum."""
    frame, unit = FRAME_AND_UNIT[source]
    return Term.model_validate(
        {"name": source, "source": source, "frame": frame, "unit": unit, "size": len(scale), "scale": scale}
    )
