"""The runtime on B simulated robots: what soaks, trains and is benchmarked."""

from collections.abc import Sequence

import numpy as np

from deploy.backends.backend import Request
from deploy.backends.sim.backend import SimBackend
from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Fault
from deploy.policy.actor import Actor
from deploy.policy.contract import Contract
from deploy.runtime import Runtime
from robots.draws import Draw
from robots.spec import RobotSpec


def simulate(
    spec: RobotSpec,
    contract: Contract,
    seeds: Sequence[np.random.SeedSequence],
    policy: Actor | None = None,
    *,
    draw: Draw | None = None,
    faults: Sequence[Fault] = (),
    threads: int = 1,
) -> tuple[Runtime, SimRobot]:
    """Build a runtime on B simulated robots, with the contract's drive gains.

    Args:
        spec: the robot. contract: of the policy.
        seeds: B seeds: one draw, one stream of noise and one sequence of goals each.
        policy: None where the caller puts its own between the halves of a tick.
        draw: B robots as they are, in place of those that the seeds would draw.
        faults: of their sensors.
        threads: for physics; results do not depend on it.

    Raises:
        ConfigError: the simulation cannot do what robot or contract ask for.
    """
    backend = SimBackend(faults, threads)
    action = contract.action
    request = Request(spec=spec, seeds=seeds, gains=action.gains, mode=action.control_mode, draw=draw)
    backend.check(request)
    robot = backend.open(request)
    runtime = Runtime(spec, contract, robot, seeds, policy)
    backend.attach(robot, runtime)
    return runtime, robot
