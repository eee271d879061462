"""Gymnasium spaces of a contract: its action, its observation, and the goals of its task."""

import numpy as np
from gymnasium.spaces import Box, Dict

from deploy.policy.contract import Contract

LARGEST = float(np.finfo(np.float32).max)
"""Bound of numbers without one: Gymnasium warns of infinite bounds."""


def action_space(contract: Contract) -> Box:
    """Raw actions (A,), within the clip of the contract."""
    low, high = np.clip(contract.action.bounds, -LARGEST, LARGEST)
    return Box(low, high, (contract.action.size,), np.float32)


def observation_space(contract: Contract) -> Box:
    """Observations (N,) of the contract, each divided by its physical maximum."""
    return Box(-LARGEST, LARGEST, (contract.observation_size,), np.float32)


def goal_space(contract: Contract, goal_size: int) -> Dict:
    """Observations with achieved and desired goal (G,), in the task's units."""
    goal = Box(-LARGEST, LARGEST, (goal_size,), np.float64)
    return Dict({"observation": observation_space(contract), "achieved_goal": goal, "desired_goal": goal})
