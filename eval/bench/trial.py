"""Some simulated minutes of some robots, judged: what the lines of the bench that vary the stack have in common."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from deploy.backends.sim.backend import simulate
from deploy.policy.policy import Policy
from eval.judge.judge import Judge
from eval.shard.job import ARM_S, POLL_S
from eval.shard.judging import judge_tick
from eval.shard.shard import rearm
from robots.arrays import Floats
from robots.draws import Draw
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec
from robots.windings import nominal_windings


class Trial:
    """Runtime, simulated robots and judge; a stage of `runtime` may be swapped before `live`."""

    def __init__(
        self,
        spec: RobotSpec,
        policy: Path,
        seeds: Sequence[np.random.SeedSequence],
        *,
        given: Draw | None = None,
    ) -> None:
        """Build everything, brakes on.

        Args:
            spec: the robot.
            policy: ONNX file.
            seeds: B seeds.
            given: B robots as they are, in the place of those that the seeds would draw.
        """
        brain = Policy.load(policy, spec)
        self.runtime, self.robot = simulate(spec, brain.contract, seeds, brain, given=given)
        self.judge = Judge(
            spec,
            torque_max(spec),
            len(seeds),
            observed=brain.contract.observed,
            scoring=self.runtime.task.rule,
        )
        self._motors = nominal_windings(spec)
        self._ohm = self._motors.resistance * self.robot.draw["drives.resistance"]

    def live(self, seconds: float) -> Iterator[None]:
        """Tick after tick, each judged, as a shard lives them: armed at first, and by an operator after a latch."""
        spec = self.runtime.spec
        look = round(POLL_S / spec.dt)
        for tick in range(round(seconds / spec.dt)):
            if tick == round(ARM_S / spec.dt):
                self.runtime.arm(np.ones(self.robot.robots, dtype=bool))
            if tick % look == 0:
                rearm(self.runtime)
            self.runtime.tick()
            judge_tick(self.judge, self.robot.truth(), self.runtime, None)
            yield

    def copper_w(self) -> Floats:
        """(B, n) W, what current now turns into heat in the windings as they really are."""
        current, warmer = self.robot.plant.current, self.robot.truth().winding_c - self._motors.reference_c
        return np.asarray(current * current * self._ohm * (1.0 + self._motors.alpha * warmer))
