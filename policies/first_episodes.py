"""The first hundred episodes of a training on four robots: intentional motion instead of random one.

Source of the criterion: the course unit, section 10: four robots, one goal an episode, intentional motion from about
episode 70 on. Here the mean final distance of episodes 81 to 100 is compared with that of a random policy.
"""

from collections.abc import Callable
from contextlib import redirect_stdout

import numpy as np
import torch
from rich.console import Console
from rsl_rl.runners import OnPolicyRunner

from deploy.tasks.task import find_task
from policies.environments.episodes import goal_steps
from policies.environments.rewards import Step
from policies.training.cli import learner_settings
from policies.training.envs import RuntimeEnv
from policies.training.recipe import LearnerStage, Recipe, find_recipe, load_recipe
from robots.arrays import Floats
from robots.spec import load_robot

ROBOTS, EPISODES, LAST = 4, 100, 20
SEEDS = range(1, 6)
STEPS, LEARNING_RATE = 50, 1e-3
"""Policy steps of each robot between two updates, and their rate: many small updates, of few data."""
ACTION_CHANGE = -0.005
"""Largest cost of changing an action: smoothness polishes a policy that reaches, and so few data show no more."""
SHARE_MAX = 0.6
"""Largest final distance that counts as intentional, as a share of a random policy's."""
RECIPES = ("planar3_velocity", "planar3_position")


def small_recipe(recipe: Recipe, seed: int) -> Recipe:
    """Return the recipe for four robots, one goal an episode."""
    spec, task = load_robot(recipe.robot), find_task(recipe.task, f"recipe {recipe.name}: task")
    steps = goal_steps(task.success_criterion(spec), recipe.promise.policy_hz)
    updates = -(-EPISODES * steps // STEPS)
    stage = LearnerStage(iterations=updates, learning_rate=LEARNING_RATE)
    learner = recipe.learner.model_copy(update={"num_steps_per_env": STEPS, "stages": (stage,)})
    environment = recipe.environment.model_copy(update={"robots": ROBOTS, "goals_per_episode": 1})
    cost = max(recipe.shaping.action_change, ACTION_CHANGE)
    shaping = recipe.shaping.model_copy(update={"action_change": cost})
    changes = {"learner": learner, "environment": environment, "shaping": shaping}
    return recipe.model_copy(update={"seed": seed, **changes})


def final_distances(recipe: Recipe, drive: Callable[[RuntimeEnv], None]) -> Floats:
    """Return (E,) m, the true distance from the goal at the end of each episode, in the order of time.

    `drive` runs an environment of the recipe.
    """
    torch.manual_seed(recipe.seed)
    torch.set_num_threads(1)
    env, found = RuntimeEnv(recipe, load_robot(recipe.robot), threads=1), []
    run, task = env.episodes.run, env.runtime.task

    def recorded(action: Floats) -> Step:
        step = run(action)
        found.extend(step.distance[task.ended].tolist())
        return step

    env.episodes.run = recorded  # type: ignore[method-assign]
    drive(env)
    return np.array(found)


def learn(env: RuntimeEnv, recipe: Recipe) -> None:
    """Train by the recipe's learner, without a log."""
    with redirect_stdout(None):
        runner = OnPolicyRunner(env, learner_settings(recipe.learner), log_dir=None, device="cpu")
        runner.learn(recipe.learner.stages[0].iterations)


def act_randomly(env: RuntimeEnv, steps: int, seed: int) -> None:
    """Run uniform random actions."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        env.step(torch.from_numpy(rng.uniform(-1.0, 1.0, (env.num_envs, env.num_actions))).float())


def compare(recipe: Recipe) -> tuple[float, float]:
    """Return m, mean final distance of the last episodes of a training, and of a random policy."""
    steps = recipe.learner.stages[0].iterations * STEPS // 4
    by_chance = final_distances(recipe, lambda env: act_randomly(env, steps, recipe.seed))
    learned = final_distances(recipe, lambda env: learn(env, recipe))
    return float(learned[-LAST * ROBOTS :].mean()), float(by_chance.mean())


def first_episodes(console: Console) -> None:
    """Print, for each recipe and seed, the mean final distance of the last episodes beside a random policy's."""
    for name in RECIPES:
        recipe = load_recipe(find_recipe(name))
        for seed in SEEDS:
            learned, by_chance = compare(small_recipe(recipe, seed))
            share = learned / by_chance
            console.print(
                f"{name}, seed {seed}: {learned:.3f} m from the goal at the end of episodes {EPISODES - LAST + 1} to"
                f" {EPISODES}, {by_chance:.3f} m at random: {100 * share:.0f} % (at most {100 * SHARE_MAX:.0f} %):"
                f" {'passed' if share <= SHARE_MAX else 'failed'}"
            )
