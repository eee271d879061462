"""The simulation as a backend, and a runtime on B simulated robots."""

from collections.abc import Callable, Sequence

import numpy as np

from deploy.backends.backend import Abilities, Backend, Request
from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Fault
from deploy.policy.contract import Contract
from deploy.policy.policy import Policy
from deploy.runtime import Runtime
from robots.draws import Draw
from robots.spec import RobotSpec


class SimBackend(Backend[SimRobot]):
    """Simulated robots in this process, with faults of their sensors, and a number of threads for their physics."""

    abilities = Abilities(control_hz=(1, 100_000), gains=True, simulated=True)

    def __init__(self, faults: Sequence[Fault] = (), threads: int = 1) -> None:
        self._faults, self._threads = faults, threads

    def open(self, request: Request) -> SimRobot:
        """Build the simulation."""
        return SimRobot(
            request.spec,
            request.seeds,
            draw=request.draw,
            faults=self._faults,
            gains=request.gains,
            threads=self._threads,
        )

    def attach(self, robot: SimRobot, runtime: Runtime) -> None:
        """Show the goals to the simulated cameras; warm the windings to the runtime's estimate."""
        robot.goal_source = lambda: runtime.task.goal_position
        robot.plant.warm(runtime.estimator.windings.rise)

    def viewer(self, robot: SimRobot) -> Callable[[object], None]:
        """Open MuJoCo's viewer."""
        from deploy.backends.sim.view import View

        return View(robot).step


def simulate(
    spec: RobotSpec,
    contract: Contract,
    seeds: Sequence[np.random.SeedSequence],
    policy: Policy | None = None,
    *,
    draw: Draw | None = None,
    faults: Sequence[Fault] = (),
    threads: int = 1,
) -> tuple[Runtime, SimRobot]:
    """Build a runtime on B simulated robots, with the contract's drive gains; arguments as of `SimRobot`, `Runtime`."""
    backend = SimBackend(faults, threads)
    request = Request(spec=spec, seeds=seeds, gains=contract.action.gains, draw=draw)
    backend.check(request)
    robot = backend.open(request)
    runtime = Runtime(spec, contract, robot, seeds, policy)
    backend.attach(robot, runtime)
    return runtime, robot
