"""Tape: recorded actions as a policy, which sees nothing."""

import numpy as np

from deploy.policy.actor import Actor
from deploy.policy.contract import Contract
from robots.arrays import Bools, Float32s


class Tape(Actor):
    """Gives all robots the same recorded actions (steps, A), one after another, then the last one.

    Attributes:
        place: (1,) number of the coming action.
    """

    carried = ("place",)

    def __init__(self, contract: Contract, actions: Float32s) -> None:
        """Begin with the first one."""
        self.contract, self.digest, self._actions = contract, "", actions
        self.place = np.zeros(1, dtype=np.int64)
        self.resize(1)

    def step(self, observation: Float32s) -> Float32s:
        """Return the next action for every robot (B, A)."""
        action = self._actions[min(int(self.place[0]), len(self._actions) - 1)]
        self.place += 1
        return np.tile(action, (len(observation), 1))

    def reset(self, ids: Bools) -> None:
        """Go on: a tape belongs to time, not to robots."""

    def resize(self, robots: int) -> None:
        """Serve any number of robots."""
