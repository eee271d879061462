"""Search for the smallest margins: CMA-ES for each monitor, from a library of adversaries.

The library is tried first. Then come cycles, each on other robots: every monitor has a search of its own, in the even
cycles from the worst candidate that anything so far has found for it, in the odd ones from an adversary of the library.
Robots of a shard try different policies at once. As their draws differ, each is compared with what the first policy of
the search does on it. Whatever is tried counts for every monitor.

Beside them, in every generation, run the searches of pushed arms: each goes on until it has converged, then begins
again on another arm.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count

import numpy as np

from eval.attack.adversaries import ADVERSARIES, OF_MANY, Adversary
from eval.attack.archive import Archive
from eval.attack.arena import Outcome
from eval.attack.candidate import Block
from eval.attack.island import FAR, NEAR, Island
from eval.shard.job import WIDTH
from robots.arrays import Floats
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

GENERATIONS = 8
"""Generations of a cycle, besides its first and last, in which all robots have one policy."""
SCREENED = 12
"""Generations at random of a pushed arm: what a push does there changes within 5 ms, and most pushes do nothing."""

Evaluate = Callable[[Sequence[Block]], Sequence[Outcome]]
"""Outcomes of blocks, in order; they may be tried in any order and any process."""


class Search:
    """Search of one robot in one mode. What it finds is a function of its seed and the number of generations.

    Attributes:
        archive: what was found so far. targets: names of the monitors that are searched for.
    """

    def __init__(
        self,
        spec: RobotSpec,
        mode: ControlMode,
        evaluate: Evaluate,
        *,
        seed: int,
        target: str = "",
        pushed_arms: Sequence[Adversary],
    ) -> None:
        """Start with an empty archive; the target is one monitor, or all hard ones.

        `pushed_arms` are searched, too; of a robot with a floating base, or beside faults, they would say nothing.
        """
        self._joints, self._evaluate, self._seed = spec.n, evaluate, seed
        self.archive = Archive(spec, mode)
        self.targets = (target,) if target else self.archive.hard
        kinds = [
            (adversary, monitor)
            for adversary in pushed_arms
            for monitor in adversary.targets
            if monitor in self.targets
        ]
        self._arms = [self._pushed_arm(*kind, number) for number, kind in enumerate(kinds)]

    def run(self) -> Iterator[None]:
        """Try one generation after another, without end."""
        rng = np.random.default_rng(self._seed)
        self._try([self._library_block(name, rng) for name in OF_MANY])
        yield
        for cycle in count():
            yield from self._cycle(cycle)

    def _library_block(self, name: str, rng: np.random.Generator) -> Block:
        """Return an adversary as it is, for half of the robots, and varied at random."""
        adversary = ADVERSARIES[name]
        varied = adversary.varied(self._joints, rng, FAR, WIDTH // 2)
        first = adversary.weights(adversary.shares(adversary.first(self._joints)), self._joints)
        return Block(name, (*(first for _ in range(WIDTH - len(varied))), *varied), self._seed)

    def _cycle(self, cycle: int) -> Iterator[None]:
        """Run the searches of a cycle side by side."""
        moved = tuple(name for name in self.targets if self.archive.moved(name)) or self.targets
        places = range(max(len(moved), len(OF_MANY)))
        islands = [self._island(cycle, place, moved[place % len(moved)]) for place in places]
        for island, outcome in zip(islands, self._try([i.first() for i in islands]), strict=True):
            island.compare_with(outcome)
        yield
        for _ in range(GENERATIONS):
            for island, outcome in zip(islands, self._try([i.ask() for i in islands]), strict=True):
                island.tell(outcome)
            yield
        self._try([island.best() for island in islands])
        yield

    def _island(self, cycle: int, place: int, target: str) -> Island:
        rng = np.random.default_rng([self._seed, 1 + cycle, place])
        adversary, start, deviation = self._start(cycle, place, target)
        seed = self._seed + 1 + cycle
        return Island(adversary, start, deviation, target, seed=seed, joints=self._joints, rng=rng)

    def _start(self, cycle: int, place: int, target: str) -> tuple[Adversary, Floats, float]:
        """Return the adversary, its first shares and their deviation."""
        if cycle % 2 == 0:
            worst = self.archive.worst_of_many[target].candidate
            adversary = ADVERSARIES[worst.adversary]
            return adversary, adversary.shares(worst.weights), NEAR
        adversary = ADVERSARIES[OF_MANY[(cycle // 2 + place) % len(OF_MANY)]]
        return adversary, adversary.shares(adversary.first(self._joints)), FAR

    def _pushed_arm(self, adversary: Adversary, monitor: str, number: int) -> Island:
        """Return a search on the arm of a number, from poses at random."""
        rng = np.random.default_rng([self._seed, 0, 1, number])  # trailing zeros do not change a seed
        first = adversary.shares(adversary.first(self._joints))
        options = {"seed": self._seed + number, "joints": self._joints, "screened": SCREENED}
        return Island(adversary, first, FAR, monitor, rng=rng, **options)

    def _try(self, blocks: Sequence[Block]) -> Sequence[Outcome]:
        """Try blocks, and a generation of every pushed arm; return the outcomes of the blocks."""
        tried = [*blocks, *(arm.ask() for arm in self._arms)]
        outcomes = self._evaluate(tried)
        for block, outcome in zip(tried, outcomes, strict=True):
            self.archive.add(block, outcome)
        for place, arm in enumerate(self._arms):
            arm.tell(outcomes[len(blocks) + place])
            if arm.over:
                number = arm.seed - self._seed + len(self._arms)
                self._arms[place] = self._pushed_arm(arm.adversary, arm.monitor, number)
        return outcomes[: len(blocks)]
