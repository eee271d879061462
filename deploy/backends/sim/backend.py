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
    """One simulated robot in this process."""

    abilities = Abilities(modes=("position",), control_hz=(1, 100_000), gains=True, simulated=True)

    def open(self, request: Request) -> SimRobot:
        """Build the simulation."""
        return SimRobot(request.spec, [request.seed], given=request.draw, gains=request.gains)

    def attach(self, robot: SimRobot, runtime: Runtime) -> None:
        """Show the goals to the simulated cameras, and warm the windings as the runtime believes them to be."""
        connect(robot, runtime)
        robot.warm(runtime.estimator.windings.rise)

    def viewer(self, robot: SimRobot) -> Callable[[object], None]:
        """Open MuJoCo's viewer."""
        from deploy.backends.sim.view import View

        return View(robot).step


def connect(robot: SimRobot, runtime: Runtime) -> None:
    """Let the simulated cameras of `robot` see the goals of the runtime's task, if it has visible ones."""
    robot.goal_source = lambda: runtime.task.goal_position


def simulate(
    spec: RobotSpec,
    contract: Contract,
    seeds: Sequence[np.random.SeedSequence],
    policy: Policy | None = None,
    *,
    given: Draw | None = None,
    faults: Sequence[Fault] = (),
    threads: int = 1,
) -> tuple[Runtime, SimRobot]:
    """Build a runtime on B simulated robots, with the contract's drive gains.

    Args:
        spec: the robot. contract: of the policy.
        policy: None where the caller puts its own between the halves of a tick.
        seeds: B seeds: one draw, one stream of noise and one sequence of goals each.
        given: B robots as they are, in place of those that the seeds would draw.
        faults: of their sensors.
        threads: for physics; results do not depend on it.
    """
    robot = SimRobot(spec, seeds, given=given, faults=faults, gains=contract.action.gains, threads=threads)
    runtime = Runtime(spec, contract, robot, seeds, policy)
    connect(robot, runtime)
    return runtime, robot
