"""What warmed the motors of simulated robots, and how warm that makes them in a whole shift."""

from dataclasses import dataclass

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.truth import Truth
from robots.arrays import Floats
from robots.motor import MotorHeat, temperatures
from robots.spec import RobotSpec
from robots.windings import nominal_windings


@dataclass(frozen=True, slots=True, kw_only=True)
class Warmth:
    """Of each joint's motor (n,), the mean of all robots.

    Attributes:
        current: A, root of the mean square. rubbed: W that friction and iron put into the housing.
        ambient: °C.
    """

    current: Floats
    rubbed: Floats
    ambient: float


class Thermometer:
    """Follows the motors of some robots in the same room from the first look on."""

    def __init__(self, robot: SimRobot) -> None:
        self._plant, self._dt = robot.plant, robot.spec.dt
        self._ambient = float(robot.draw["climate.ambient_c"][0])
        self._began = self._housing = robot.truth().housing_c.copy()
        self._square, self._over_room, self._rise = np.zeros((3, *self._began.shape))
        self._looks = 0

    def look(self, truth: Truth) -> None:
        """After every tick."""
        self._looks += 1
        self._square += self._plant.current**2
        self._over_room += truth.housing_c - self._ambient
        self._rise += truth.winding_c - truth.housing_c
        self._housing = truth.housing_c.copy()

    def warmth(self) -> Warmth:
        """By the housings' own balance: what warmed them, less what windings gave, is friction and iron."""
        housings, looks = self._plant.housings, self._looks
        stored = housings.capacity * (self._housing - self._began) / (looks * self._dt)
        lost, given = self._over_room / housings.to_ambient, self._rise / self._plant.windings.to_housing
        rubbed = stored + (lost - given) / looks
        return Warmth(
            current=np.sqrt(self._square.mean(axis=0) / looks),
            rubbed=np.maximum(rubbed.mean(axis=0), 0.0),
            ambient=self._ambient,
        )


def windings_after(spec: RobotSpec, warmth: Warmth, t: float) -> Floats:
    """(n,) °C, windings that were as cold as their room `t` s ago and worked like that ever since.

    What warms a housing from outside its winding warms both nodes alike in the end, as a warmer room would.
    """
    motors = nominal_windings(spec)
    to_ambient = spec.motor_array("housing_resistance_k_per_w")
    capacity = spec.motor_array("housing_capacity_j_per_k")
    room = warmth.ambient + warmth.rubbed * to_ambient * (1.0 - np.exp(-t / (to_ambient * capacity)))
    found = []
    for j in range(spec.n):
        heat = MotorHeat(
            resistance=float(motors.resistance[j]),
            alpha=float(motors.alpha[j]),
            reference_c=float(motors.reference_c[j]),
            winding_to_housing=float(motors.to_housing[j]),
            housing_to_ambient=float(to_ambient[j]),
            winding_capacity=float(motors.capacity[j]),
            housing_capacity=float(capacity[j]),
        )
        found.append(temperatures(heat, float(warmth.current[j]), float(room[j]), t)[0])
    return np.array(found)
