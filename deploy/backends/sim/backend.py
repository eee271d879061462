"""The simulation as a backend."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from deploy.backends.backend import Abilities, Backend, Request
from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Fault
from robots.motors.control_mode import ControlMode

if TYPE_CHECKING:
    from deploy.runtime import Runtime


class SimBackend(Backend[SimRobot]):
    """Simulated robots in this process, with faults of their sensors, and a number of threads for their physics."""

    abilities = Abilities(control_hz=(1, 100_000), gains=True, modes=tuple(ControlMode), simulated=True)

    def __init__(self, faults: Sequence[Fault] = (), threads: int = 1) -> None:
        self._faults, self._threads = faults, threads

    def open(self, request: Request) -> SimRobot:
        """Build the simulation."""
        return SimRobot(
            request.spec,
            request.seeds,
            draw=request.draw,
            faults=self._faults,
            threads=self._threads,
        )

    def attach(self, robot: SimRobot, runtime: "Runtime") -> None:
        """Show the goals to the simulated cameras; warm the windings to the runtime's estimate."""
        task = runtime.task  # not the runtime, which holds the robot: both would stay in memory
        robot.goal_source = lambda: task.goal_position
        robot.plant.warm(runtime.estimator.windings.rise)

    def viewer(self, robot: SimRobot) -> Callable[[object], None]:
        """Open MuJoCo's viewer."""
        from deploy.backends.sim.view import View

        return View(robot).step
