"""B simulated robots behind the interface of a real one."""

from collections.abc import Callable, Sequence

import numpy as np

from deploy.backends.sim.packets import Fault
from deploy.backends.sim.plant import Plant
from deploy.backends.sim.sensors import Sensors
from deploy.backends.sim.truth import Truth
from deploy.motion.drive_law import Gains
from deploy.stage import Stage
from deploy.state import Command, Sample
from robots.arrays import Bools, Floats
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.spec import RobotSpec


class SimRobot(Stage):
    """Physics advances one control period with every `write`.

    Attributes:
        goal: (B, 3) m, world, as the simulated cameras see it; NaN: none.
        goal_source: where `read` takes the goals from, or None.
    """

    carried = ("goal",)
    parts = ("plant", "sensors")

    def __init__(
        self,
        spec: RobotSpec,
        seeds: Sequence[np.random.SeedSequence],
        *,
        given: Draw | None = None,
        faults: Sequence[Fault] = (),
        gains: Gains | None = None,
        threads: int = 1,
    ) -> None:
        """Draw B robots and put them at home, brakes on.

        Args:
            spec: the robot as it should be.
            seeds: B seeds: one draw, one stream of noise each.
            given: B robots as they are, in the place of those that the seeds would draw.
            faults: of their sensors.
            gains: of their drives, as the policy's contract has them; None: the drives' own.
            threads: for physics; results do not depend on it.
        """
        self.spec, self.robots, self.gains = spec, len(seeds), gains
        distributions = load_distributions(spec)
        self.draw = given or draw(distributions, spec, seeds)
        self.plant = Plant(spec, distributions, self.draw, seeds, gains=gains, threads=threads)
        self.sensors = Sensors(spec, self.draw, seeds, faults)
        self.goal_source: Callable[[], Floats] | None = None
        self.goal = np.full((self.robots, 3), np.nan)
        self._exposed = [
            self.goal if kind == "goal" else self.plant.reading(kind) for kind in self.spec.sensors
        ]
        self._settle(np.ones(self.robots, dtype=bool))

    def read(self) -> Sample:
        """Return the newest packets; goals that are visible from now on arrive in later ones."""
        if self.goal_source is not None:
            self.goal[:] = self.goal_source()
        return self.sensors.read()

    def write(self, command: Command) -> None:
        """Command every robot for one control period and live through it."""
        self.plant.step(command)
        self.sensors.take(self._readings())

    def _readings(self) -> Floats:
        """(B, C) what is true where each sensor sits."""
        return np.concatenate(self._exposed, axis=1)

    def _settle(self, ids: Bools) -> None:
        self.sensors.reset(ids, self._readings())

    def stop(self, ids: Bools) -> None:
        """Category 0: brakes close now on the pose they find."""
        self.plant.brake(ids)

    def close(self) -> None:
        """Nothing to release."""

    def reset(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` holds at `q` (B, n) rad, motors as at the start of the shift."""
        self.plant.reset(ids, q)
        self._settle(ids)

    def warm(self, rise: Floats) -> None:
        """Windings are (B, n) K warmer than their housings, from a life before this one."""
        self.plant.warm(rise)

    def truth(self) -> Truth:
        """What really holds now: not for the runtime."""
        return self.plant.truth(float(self.sensors.tick[0]) * self.spec.dt)
