"""Actor: what turns observations into actions, a policy or an operator."""

from abc import ABC, abstractmethod

from deploy.policy.contract import Contract
from deploy.stage import Stage
from robots.arrays import Bools, Float32s


class Actor(Stage, ABC):
    """Actions of B robots, by a contract.

    Attributes:
        contract: meaning of the numbers.
        digest: SHA-256 of what the actor was made from.
        failure: what a library said when a step failed; empty if none did.
    """

    contract: Contract
    digest: str
    failure: str = ""

    @abstractmethod
    def step(self, observation: Float32s) -> Float32s:
        """Return raw actions (B, A) for observations (B, N): valid until the next step."""

    @abstractmethod
    def reset(self, ids: Bools) -> None:
        """Forget the past of robots where `ids` (B,) holds."""

    @abstractmethod
    def resize(self, robots: int) -> None:
        """Resize to B robots, all of them reset."""
