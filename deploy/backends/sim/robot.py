"""B simulated robots behind the interface of a real one."""

from collections.abc import Callable, Sequence

import numpy as np

from deploy.backends.sim.goal_distance import GoalDistance
from deploy.backends.sim.plant import Plant
from deploy.backends.sim.sensor_faults import Fault
from deploy.backends.sim.sensors import Sensors
from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import Command, Sample
from deploy.truth import Truth
from robots.arrays import Bools, Floats
from robots.distributions import load_distributions
from robots.draws import Draw
from robots.draws import draw as draw_robots
from robots.errors import ConfigError
from robots.spec import RobotSpec


class SimRobot(Stage):
    """Plant and sensors of B robots. Physics advances one control period with every `write`.

    Attributes:
        goal: (B, 3) m, world, as the simulated cameras see it; NaN: none.
        goal_source: where `read` takes the goals from, or None.
        distance: simulated distance sensor, or None.
    """

    carried = ("goal",)
    parts = ("plant", "sensors")

    def __init__(
        self,
        spec: RobotSpec,
        seeds: Sequence[np.random.SeedSequence],
        *,
        draw: Draw | None = None,
        faults: Sequence[Fault] = (),
        threads: int = 1,
    ) -> None:
        """Draw B robots and put them at home, brakes closed.

        Args:
            spec: the robot as it should be.
            seeds: B seeds: one draw, one stream of noise each.
            draw: B robots as they are, in place of those that the seeds would draw.
            faults: of their sensors.
            threads: for physics; results do not depend on it.
        """
        self.spec, self.robots = spec, len(seeds)
        distributions = load_distributions(spec)
        self.draw = draw or draw_robots(distributions, spec, seeds)
        self.plant = Plant(spec, distributions, self.draw, seeds, threads=threads)
        self.sensors = Sensors(spec, self.draw, seeds, faults)
        self.goal_source: Callable[[], Floats] | None = None
        self.goal = np.full((self.robots, 3), np.nan)
        self.distance = GoalDistance(self.plant.batch, self.plant.beam) if self.plant.beam else None
        readings = {**self.plant.readings, "goal": self.goal}
        if self.distance:
            readings["distance"] = self.distance.value
            self.distance.reset(np.ones(self.robots, dtype=bool), self.goal)
        if unknown := [kind for kind in spec.sensors if kind not in readings]:
            raise ConfigError(f"{spec.folder / 'robot.toml'}: sensors: {unknown[0]} cannot be simulated")
        self._true_values = [readings[kind] for kind in spec.sensors]
        self.settle_sensors(np.ones(self.robots, dtype=bool))

    def stages(self) -> dict[str, Stage]:
        """Stages inside, the distance sensor included."""
        return super().stages() | ({"distance": self.distance} if self.distance else {})

    def read(self) -> Sample:
        """Return the newest packets; goals that are visible from now on arrive in later ones.

        Where the computer is late, the robot has gone on by itself before.
        """
        if any_true(self.plant.late):
            for robot in np.flatnonzero(self.plant.late):
                self._wait(int(robot), int(self.plant.late[robot]))
            self.plant.late[:] = 0
        if self.goal_source is not None:
            self.goal[:] = self.goal_source()
        return self.sensors.read()

    def write(self, command: Command) -> None:
        """Advance every robot one control period under its command."""
        self.plant.contacts.show(self.goal)
        if self.distance:
            self.distance.aim(self.goal)
        self.plant.step(command)
        if self.distance:
            self.distance.measure(self.goal)
        self.sensors.sample(self._channels())

    def _wait(self, robot: int, periods: int) -> None:
        for noise in self.sensors.noise_of_wait(robot, periods):
            self.plant.wait(robot)
            if self.distance:
                self.distance.measure(self.goal)
            self.sensors.wait(robot, self._channels(), noise)

    def _channels(self) -> Floats:
        return np.concatenate(self._true_values, axis=1)

    def settle_sensors(self, ids: Bools) -> None:
        """Reset sensors where `ids` holds, as if the present values had been there for a while."""
        self.sensors.reset(ids, self._channels())

    def stop(self, ids: Bools) -> None:
        """Category 0 stop: brakes close now on the present pose."""
        self.plant.brake(ids)

    def close(self) -> None:
        """Nothing to release."""

    def reset(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` holds at `q` (B, n) rad, motors as at the start."""
        self.plant.reset(ids, q)
        self._settle(ids)

    def settle_goal(self, ids: Bools) -> None:
        """Reset sensors where `ids` holds, as if the goals of now had been visible for a while."""
        if self.goal_source is not None:
            self.goal[ids] = self.goal_source()[ids]
        self._settle(ids)

    def _settle(self, ids: Bools) -> None:
        if self.distance:
            self.distance.reset(ids, self.goal)
        self.settle_sensors(ids)

    def truth(self) -> Truth:
        """Return the ground truth now: not for the runtime."""
        return self.plant.truth(float(self.sensors.tick[0]) * self.spec.dt)
