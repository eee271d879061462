"""Crowd: an adversary of its own for every robot of a shard, so that one simulation tries as many."""

import numpy as np

from deploy.policy.actor import Actor
from deploy.policy.inference import load_session
from deploy.policy.policy_file import PolicyFile
from deploy.policy.policy_names import INPUT, MEMORY, NEXT, OUTPUT
from robots.arrays import Bools, Float32s


class Crowd(Actor):
    """Policies of B robots in one graph. Each row gives what the file of its weights alone would give.

    Attributes:
        memory: (B, M) recurrent state.
    """

    carried = ("memory",)

    def __init__(self, file: PolicyFile) -> None:
        """Load a file for as many robots as it has golden pairs."""
        robots = len(file.observation)
        self.contract, self.digest = file.contract, file.digest
        self._session = load_session(file.data, "adversaries", (robots,))
        self.resize(robots)

    def step(self, observation: Float32s) -> Float32s:
        """Return raw actions (B, A) for observations (B, N)."""
        feeds = {INPUT: observation, MEMORY: self.memory}
        action, self.memory[:] = self._session.run([OUTPUT, NEXT], feeds)
        return np.asarray(action)

    def reset(self, ids: Bools) -> None:
        """Clear the memory of robots where `ids` (B,) holds."""
        self.memory[ids] = 0.0

    def resize(self, robots: int) -> None:
        """Resize to B robots, all of them reset."""
        self.memory = np.zeros((robots, self.contract.memory), np.float32)
