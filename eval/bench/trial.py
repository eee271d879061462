"""Judged simulation of some robots, whose stages may be replaced before it starts."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from deploy.policy.policy import Policy
from deploy.simulation import simulate
from eval.shard.job import ARM_S, POLL_S
from eval.shard.judging import judge_tick, make_judge
from eval.shard.shard import rearm
from robots.arrays import Floats
from robots.draws import Draw
from robots.motors.windings import nominal_windings
from robots.spec import RobotSpec


class Trial:
    """Runtime, simulated robots and judge, in one process and one thread."""

    def __init__(
        self,
        spec: RobotSpec,
        policy: Path,
        seeds: Sequence[np.random.SeedSequence],
        *,
        draw: Draw | None = None,
    ) -> None:
        """Build everything for B seeds, with brakes on; `draw` replaces the parameters drawn from the seeds."""
        self.policy = Policy.load(policy, spec)
        contract = self.policy.contract
        self.runtime, self.robot = simulate(spec, contract, seeds, self.policy, draw=draw)
        self.judge = make_judge(spec, contract, len(seeds))
        self._motors = nominal_windings(spec)
        self._ohm = self._motors.resistance * self.robot.draw["drives.resistance"]

    def tick(self) -> None:
        """Advance one tick and judge it."""
        self.runtime.tick()
        judge_tick(self.judge, self.robot.truth(), self.runtime, None)

    def advance(self, seconds: float) -> Iterator[None]:
        """Yield after each judged tick; robots are armed at the start and again after a latch, as in a shard."""
        dt = self.runtime.spec.dt
        for tick in range(round(seconds / dt)):
            if tick == round(ARM_S / dt):
                self.runtime.arm(np.ones(self.robot.robots, dtype=bool))
            if tick % round(POLL_S / dt) == 0:
                rearm(self.runtime)
            self.tick()
            yield

    def copper_loss(self) -> Floats:
        """(B, n) W, present heat from current in the windings, by their true resistance and temperature."""
        current, warmer = self.robot.plant.current, self.robot.truth().winding_c - self._motors.reference_c
        return np.asarray(current * current * self._ohm * (1.0 + self._motors.alpha * warmer))
