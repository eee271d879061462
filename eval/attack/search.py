"""Search for the smallest margins: rounds of CMA-ES, each for one monitor, from a library of adversaries.

The library is tried first. Then monitors take turns: in one cycle of rounds each is searched from the worst candidate
that any round has found for it, on the same robots; in the next from an adversary of the library, on other robots.
Whatever a round tries counts for every monitor.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count

import cma
import numpy as np

from eval.attack.adversaries import ADVERSARIES
from eval.attack.archive import Archive
from eval.attack.arena import Outcome
from eval.attack.candidate import Candidate
from robots.arrays import Floats
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

VARIANTS = 4
"""Trials of each adversary of the library at the start: as it is, and varied at random."""
POPULATION, GENERATIONS = 12, 8
"""Candidates of a generation, generations of a round."""
FAR, NEAR = 0.2, 0.08
"""Standard deviations of a round's first generation, as shares of the bounds, from the library and from the worst."""
LARGEST = 1e6
"""Bound of ratios that are minimized: an infinite one has no order."""

Evaluate = Callable[[Sequence[Candidate]], Sequence[Outcome]]
"""Outcomes of candidates, in order; they may be tried in any order and any process."""


class Search:
    """Search of one robot in one mode. What it finds is a function of its seed and the number of generations.

    Attributes:
        archive: what was found so far. targets: names of the monitors that are searched for.
    """

    def __init__(
        self, spec: RobotSpec, mode: ControlMode, evaluate: Evaluate, *, seed: int, target: str = ""
    ) -> None:
        """Start with an empty archive; the target is one monitor, or all hard ones."""
        self._joints, self._evaluate, self._seed = spec.n, evaluate, seed
        self.archive = Archive(spec, mode)
        self.targets = (target,) if target else self.archive.hard

    def run(self) -> Iterator[None]:
        """Try one generation after another, without end."""
        rng = np.random.default_rng(self._seed)
        for name in ADVERSARIES:
            first = self._first_shares(name)
            varied = [self._varied(first, rng) for _ in range(VARIANTS - 1)]
            self._try(name, [first, *varied], self._seed)
            yield
        for number in count():
            yield from self._round(number)

    def _round(self, number: int) -> Iterator[None]:
        rng = np.random.default_rng([self._seed, number])
        name, start, seed, deviation, monitor = self._plan(number, rng)
        strategy = cma.CMAEvolutionStrategy(
            start,
            deviation,
            {
                **{"bounds": [0.0, 1.0], "popsize": POPULATION, "seed": np.nan},
                **{"randn": lambda *shape: rng.standard_normal(shape), "verbose": -10, "verb_log": 0},
            },
        )
        for _ in range(GENERATIONS):
            shares = strategy.ask()
            outcomes = self._try(name, shares, seed)
            strategy.tell(shares, [-min(outcome.worst[monitor], LARGEST) for outcome in outcomes])
            yield

    def _plan(self, number: int, rng: np.random.Generator) -> tuple[str, Floats, int, float, str]:
        """Return a round's adversary, first shares, seed of draws, deviation and monitor."""
        targets = self._moved_targets()
        cycle, place = divmod(number, len(targets))
        worst = self.archive.worst[targets[place]].candidate
        if cycle % 2 == 0:
            return worst.adversary, self._shares(worst), worst.seed, NEAR, targets[place]
        names = tuple(ADVERSARIES)
        name = names[(cycle // 2 + place) % len(names)]
        start = self._varied(self._first_shares(name), rng)
        return name, start, self._seed + 1 + number, FAR, targets[place]

    def _moved_targets(self) -> tuple[str, ...]:
        """Return the targets whose ratio was ever above 0, which a search can follow; all if there are none."""
        moved = tuple(name for name in self.targets if self.archive.worst[name].ratio > 0.0)
        return moved or self.targets

    def _try(self, name: str, shares: Sequence[Floats], seed: int) -> Sequence[Outcome]:
        candidates = [Candidate(name, ADVERSARIES[name].weights(each, self._joints), seed) for each in shares]
        outcomes = self._evaluate(candidates)
        self.archive.add(candidates, outcomes)
        return outcomes

    def _first_shares(self, name: str) -> Floats:
        return ADVERSARIES[name].shares(ADVERSARIES[name].first(self._joints))

    def _shares(self, candidate: Candidate) -> Floats:
        return np.clip(ADVERSARIES[candidate.adversary].shares(candidate.weights), 0.0, 1.0)

    def _varied(self, shares: Floats, rng: np.random.Generator) -> Floats:
        return np.clip(rng.normal(shares, FAR), 0.0, 1.0)
