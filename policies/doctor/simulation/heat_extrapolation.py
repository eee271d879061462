"""Heat load of motors in a simulated run, and its extrapolation to winding temperatures of a whole shift."""

from dataclasses import dataclass

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.truth import Truth
from robots.arrays import Floats
from robots.motors.motor import MotorHeat, temperatures
from robots.motors.windings import nominal_windings
from robots.spec import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class HeatLoad:
    """Heat load of each joint's motor (n,), mean of all robots.

    Attributes:
        current: A, root mean square. friction_power: W from friction and iron losses into the housing.
        ambient: °C.
    """

    current: Floats
    friction_power: Floats
    ambient: float


class HeatRecorder:
    """Recorder of motor currents and temperatures, for robots with the same ambient temperature."""

    def __init__(self, robot: SimRobot) -> None:
        self._plant, self._dt = robot.plant, robot.spec.dt
        self._ambient = float(robot.draw["climate.ambient_c"][0])
        self._initial_housing = self._housing = robot.truth().housing_c.copy()
        self._square, self._housing_rise, self._winding_rise = np.zeros((3, *self._initial_housing.shape))
        self._ticks = 0

    def record(self, truth: Truth) -> None:
        """Add one tick."""
        self._ticks += 1
        self._square += self._plant.current**2
        self._housing_rise += truth.housing_c - self._ambient
        self._winding_rise += truth.winding_c - truth.housing_c
        self._housing = truth.housing_c.copy()

    def heat_load(self) -> HeatLoad:
        """Return the heat load; friction and iron losses follow from the heat balance of the housings."""
        housings, ticks = self._plant.housings, self._ticks
        stored = housings.capacity * (self._housing - self._initial_housing) / (ticks * self._dt)
        lost = self._housing_rise / housings.to_ambient
        received = self._winding_rise / self._plant.windings.to_housing
        friction_power = stored + (lost - received) / ticks
        return HeatLoad(
            current=np.sqrt(self._square.mean(axis=0) / ticks),
            friction_power=np.maximum(friction_power.mean(axis=0), 0.0),
            ambient=self._ambient,
        )


def winding_temperature(spec: RobotSpec, heat_load: HeatLoad, t: float) -> Floats:
    """Return winding temperatures (n,) °C after `t` s of constant heat load, starting at ambient temperature.

    Friction power heats housing and winding alike in the end, so it is modelled as a higher ambient temperature.
    """
    to_ambient = spec.motor_array("housing_resistance_k_per_w")
    share = 1.0 - np.exp(-t / (to_ambient * spec.motor_array("housing_capacity_j_per_k")))
    ambient = heat_load.ambient + heat_load.friction_power * to_ambient * share
    loads = zip(_motors(spec), heat_load.current.tolist(), ambient.tolist(), strict=True)
    return np.array([temperatures(motor, current, around, t)[0] for motor, current, around in loads])


def _motors(spec: RobotSpec) -> list[MotorHeat]:
    motors = nominal_windings(spec)
    constants = {
        "resistance": motors.resistance,
        "alpha": motors.alpha,
        "reference_c": motors.reference_c,
        "winding_to_housing": motors.to_housing,
        "housing_to_ambient": spec.motor_array("housing_resistance_k_per_w"),
        "winding_capacity": motors.capacity,
        "housing_capacity": spec.motor_array("housing_capacity_j_per_k"),
    }
    return [MotorHeat(**{name: float(each[j]) for name, each in constants.items()}) for j in range(spec.n)]
