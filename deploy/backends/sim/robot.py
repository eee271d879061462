"""B simulated robots behind the interface of a real one."""

from collections.abc import Sequence

import numpy as np

from deploy.backends.sim.plant import Plant
from deploy.backends.sim.sensors import Sensors
from deploy.backends.sim.truth import Truth
from deploy.state import Bools, Command, Floats, Sample
from robots.draws import draw, load_distributions
from robots.spec import RobotSpec


class SimRobot:
    """Physics advances one control period with every `write`."""

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence], *, threads: int = 1) -> None:
        """Draw B robots and put them at home, brakes on.

        Args:
            spec: the robot as it should be.
            seeds: B seeds: one draw, one stream of noise each.
            threads: for physics; results do not depend on it.
        """
        self.spec, self.robots = spec, len(seeds)
        self.draw = draw(load_distributions(spec), spec.n, seeds)
        self.plant = Plant(spec, self.draw, threads=threads)
        self.sensors = Sensors(spec, self.draw, seeds)
        self.sensors.reset(np.ones(self.robots, dtype=bool), self.plant.q)

    def read(self) -> Sample:
        """The newest packets."""
        return self.sensors.read(self.plant.current, self.plant.housing)

    def write(self, command: Command) -> None:
        """Command every robot for one control period and live through it."""
        self.plant.step(command)
        self.sensors.take(self.plant.q)

    def stop(self, ids: Bools) -> None:
        """Category 0: brakes close now on the pose they find."""
        self.plant.brake(ids)

    def reset(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` holds at `q` (B, n) rad, motors as at the start of the shift."""
        self.plant.reset(ids, q)
        self.sensors.reset(ids, q)

    def truth(self) -> Truth:
        """What really holds now: not for the runtime."""
        return self.plant.truth(float(self.sensors.tick[0]) * self.spec.dt)
