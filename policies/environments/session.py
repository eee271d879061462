"""B simulated robots for Gymnasium: seeds, transitions, and the episodes that end and begin."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from numpy.typing import NDArray

from deploy.tasks.task import find_task
from policies.environments.episodes import End, Episodes, goal_steps
from policies.environments.goal_reward import TERMS, GoalReward
from policies.environments.rewards import Step, reward_terms
from policies.environments.settings import read_settings
from policies.environments.spaces import action_space, goal_space, observation_space
from robots.arrays import Bools, Float32s, Floats
from robots.errors import ConfigError
from robots.randomness import Stream, generator_at, stream_keys, training_seed

Observation = Float32s | dict[str, NDArray[Any]]
"""Rows (B, N); with goals, a dictionary of rows."""
Info = dict[str, NDArray[np.generic]]


class Transition(NamedTuple):
    """Transition of B robots; the observation of an episode that ended is its last."""

    observation: Observation
    reward: Floats
    end: End
    info: Info


class Session:
    """B robots that a seed made; everything that happens follows from the seeds and the actions.

    Attributes:
        settings: checked options. action_space, observation_space: of one robot.
        max_steps: policy steps of an episode.
        reward: sparse reward for any goal.
    """

    def __init__(self, options: Mapping[str, object], robots: int, *, goal: bool) -> None:
        """Check the options; `seed` builds the simulation. With `goal`, observations are dictionaries.

        Raises:
            FirstshiftError: naming the option that is wrong.
        """
        self.settings = read_settings(options, goal=goal)
        spec, recipe, contract = self.settings.spec, self.settings.recipe, self.settings.contract
        criterion = find_task(recipe.task, "option task").success_criterion(spec)
        self.robots, self._goal = robots, goal
        self.reward = GoalReward(criterion, recipe.reward)
        self.action_space: Box = action_space(contract)
        self.observation_space: Box | Dict = (
            goal_space(contract, criterion.size) if goal else observation_space(contract)
        )
        self.max_steps = recipe.environment.goals_per_episode * goal_steps(criterion, contract.policy_hz)
        self._episodes: Episodes | None = None
        self._steps, self._number = np.zeros((2, robots), dtype=np.int64)

    @property
    def episodes(self) -> Episodes:
        """Robots and their runtime; ResetNeeded before the first reset."""
        if self._episodes is None:
            raise ResetNeeded("reset() comes first")
        return self._episodes

    @property
    def seeded(self) -> bool:
        """True once there are robots."""
        return self._episodes is not None

    def seed(self, seeds: Sequence[int]) -> None:
        """Build B robots from B seeds: one draw, one stream of noise, one sequence of goals and poses each."""
        settings, sequences = self.settings, [training_seed(seed, 0) for seed in seeds]
        self._episodes = Episodes(
            settings.recipe, settings.spec, settings.contract, sequences, threads=settings.threads
        )
        self._start_keys = stream_keys(sequences, Stream.START_POSES)
        self._number[:] = 0

    def begin(self, ids: Bools) -> None:
        """Begin episodes of robots where `ids` (B,) holds; `observe` comes next."""
        q = np.zeros((self.robots, self.settings.spec.n))
        for robot in np.flatnonzero(ids):
            rng = generator_at(self._start_keys[robot], int(self._number[robot]))
            q[robot] = self.episodes.start_poses(rng)[0]
        self.episodes.restart(ids, q)
        # Not in `restart`: in training a new goal arrives late as all goals do, and recipes must repeat their policies.
        self.episodes.robot.settle_goal(ids)
        self._steps[ids] = 0
        self._number[ids] += 1

    def observe(self) -> Observation:
        """Return the observation of B robots; once in a policy step."""
        sensed, task = self.episodes.sense(), self.episodes.task
        if not self._goal:
            return sensed
        return {
            "observation": sensed,
            "achieved_goal": task.achieved.copy(),
            "desired_goal": task.goal.copy(),
        }

    def step(self, action: object) -> Transition:
        """Run one policy step; where an episode ended, `begin` and `observe` come next."""
        runtime, task = self.episodes.runtime, self.episodes.task
        goal, step = task.goal.copy(), self.episodes.run(self._checked(action))
        self._steps += 1
        end = self.episodes.end(step, self._steps >= self.max_steps)
        # The last observation of an episode is a look ahead: the tick is sensed again once the next one has begun.
        saved = runtime.save() if end.done.any() else None
        observation = self.observe()
        if isinstance(observation, dict):
            observation["desired_goal"][end.done] = goal[end.done]
        info = self._info(step)
        reward = self.episodes.reward(step)
        if isinstance(observation, dict):
            reward = self.reward(observation["achieved_goal"], observation["desired_goal"], info)
        if saved is not None:
            runtime.restore(saved)
        return Transition(observation, reward, end, info)

    def _info(self, step: Step) -> Info:
        """Return success and what the reward for other goals needs; a diverged simulation costs what a limit costs."""
        episodes, weights = self.episodes, self.settings.recipe.reward
        valid, task = episodes.robot.plant.valid, episodes.task
        achieved = task.true_achieved(episodes.robot.truth())
        running = step.running & valid
        info: Info = {
            "is_success": step.near & valid,
            "running": running,
            "achieved_error": np.where(valid[:, None], achieved - task.achieved, 0.0),
        }
        terms = reward_terms(step, episodes.limits, weights)
        for name in TERMS:
            of_diverged = weights.joint_limit if name == "joint_limit" else 0.0
            info[name] = np.where(valid, getattr(terms, name), of_diverged)
        return info

    def _checked(self, action: object) -> Floats:
        array = np.asarray(action, dtype=np.float64)
        expected = (self.robots, *self.action_space.shape)
        if array.shape != expected:
            raise ConfigError(f"action: found shape {array.shape}, expected {expected}")
        return array
