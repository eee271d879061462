"""Hot motors at the start: of plant, sensors and runtime, which then knows how warm the windings are."""

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.runtime import Runtime
from robots.arrays import Bools, Floats


def heat_motors(runtime: Runtime, robot: SimRobot, ids: Bools, housing: Floats, rise: Floats) -> None:
    """Heat the motors of robots `ids` (B,) before the first tick.

    Args:
        housing: (n,) °C. rise: (n,) K, of windings above their housings.
    """
    plant, windings = robot.plant, runtime.estimator.windings
    rises = np.where(ids[:, None], rise, windings.rise)
    plant.housing[ids] = housing
    plant.housings.apply()
    robot.settle_sensors(ids)
    plant.warm(rises)
    windings.resume(rises, 0.0)
