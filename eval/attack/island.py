"""Island: one search by CMA-ES, of one adversary's weights for one monitor, on the robots of a shard."""

import cma
import numpy as np

from eval.attack.adversaries import Adversary
from eval.attack.arena import Outcome
from eval.attack.candidate import Block
from eval.shard.job import WIDTH
from robots.arrays import Floats

FAR, NEAR, NEXT = 0.2, 0.08, 0.03
"""Standard deviations of a first generation, as shares of the bounds: from the library, from the worst so far, and from
the best of those that were screened."""
COMPARED_BY = {"position_hard": "position_soft"}
"""Monitors by whose ratios candidates are compared, in place of the one that is searched for: at the end of a wide
range a milliradian is a smaller share than at that of a narrow one; at soft limits the ratios of all joints are 1."""
LARGEST = 1e6
"""Bound of the ratios that are compared: infinite ones have no order."""


def evolution_strategy(
    start: Floats, deviation: float, size: int, rng: np.random.Generator
) -> cma.CMAEvolutionStrategy:
    """Return a search from `start` (D,) by generations of `size` vectors of numbers from 0 to 1.

    Source: Hansen, The CMA Evolution Strategy: A Tutorial (2016), by the library cma.
    """
    options = {"bounds": [0.0, 1.0], "popsize": size, "verbose": -10, "verb_log": 0}
    random = {"seed": np.nan, "randn": lambda *shape: rng.standard_normal(shape)}
    return cma.CMAEvolutionStrategy(np.clip(start, 0.0, 1.0), deviation, options | random)


class Island:
    """Search in which each robot of a shard tries a policy of its own in every generation.

    Attributes:
        adversary: of the policies. monitor: that is searched for. seed: of the robots.
    """

    def __init__(
        self,
        adversary: Adversary,
        start: Floats,
        deviation: float,
        monitor: str,
        *,
        seed: int,
        joints: int,
        rng: np.random.Generator,
        screened: int = 0,
    ) -> None:
        """Start from shares (D,) of the bounds of the weights that an adversary searches.

        In the first `screened` generations, weights vary at random, and the search starts from the best of them.
        """
        self.adversary, self.monitor, self.seed, self._joints = adversary, monitor, seed, joints
        self._rng, self._deviation, self._screened = rng, deviation, screened
        self._start, self._base, self._best = start, np.zeros(WIDTH), (-np.inf, start)
        self._strategy = None if screened else evolution_strategy(start, deviation, WIDTH, rng)

    def first(self) -> Block:
        """Return the start, for all robots."""
        return self._block([self._start] * WIDTH)

    def compare_with(self, outcome: Outcome) -> None:
        """Take what the start did on each robot for the base of all comparisons."""
        self._base = self._ratios(outcome)

    def ask(self) -> Block:
        """Return the next generation."""
        if self._strategy is not None:
            self._shares = self._strategy.ask()
        else:
            drawn = self._rng.normal(self._start, self._deviation, (WIDTH, len(self._start)))
            self._shares = [*np.clip(drawn, 0.0, 1.0)]
        return self._block(self._shares)

    def tell(self, outcome: Outcome) -> None:
        """Learn from the outcome of the generation."""
        gain = self._ratios(outcome) - self._base
        if float(gain.max()) > self._best[0]:
            self._best = float(gain.max()), self._shares[gain.argmax()]
        if self._strategy is not None:
            self._strategy.tell(self._shares, (-gain).tolist())
            return
        self._screened -= 1
        if not self._screened:
            self._strategy = evolution_strategy(self._best[1], NEXT, WIDTH, self._rng)

    @property
    def over(self) -> bool:
        """True once the search has converged."""
        return self._strategy is not None and bool(self._strategy.stop())

    def best(self) -> Block:
        """Return the policy that gained most, for all robots."""
        return self._block([self._best[1]] * WIDTH)

    def _ratios(self, outcome: Outcome) -> Floats:
        return np.minimum(outcome.worst[COMPARED_BY.get(self.monitor, self.monitor)], LARGEST)

    def _block(self, shares: list[Floats]) -> Block:
        rows = tuple(self.adversary.weights(each, self._joints) for each in shares)
        return Block(self.adversary.name, rows, self.seed)
