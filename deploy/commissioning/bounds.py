"""Bounds of what the check measures, from robot.toml, the model and the spans of draws.toml."""

from typing import NamedTuple

import numpy as np

from deploy.commissioning.gravity import DrawnGravity
from deploy.commissioning.sweeps import Sweep
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.models.nominal_model import load_pinocchio
from robots.motors.drive_gains import drive_gains
from robots.motors.windings import nominal_windings
from robots.spec import RobotSpec

SCALE = 0.02
"""Largest difference of a scale from 1. Wrong gear ratios and encoder lines are wrong by more."""
ERRORS = 5.0
"""Standard errors of a measurement by which it may be outside."""
SPREAD = 4.0
"""Standard deviations of gravity over drawn robots by which one may differ from their mean."""


class Measured(NamedTuple):
    """Measured number and its bounds; `low` and `high` may be infinite."""

    value: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """True if the number is within its bounds."""
        return self.low <= self.value <= self.high


class Bounds:
    """Bounds of every joint.

    Attributes:
        constant: (n,) N·m/A, nominal, at the joints.
    """

    def __init__(self, spec: RobotSpec) -> None:
        """Read model and distributions; `spec` is the robot at full speed."""
        self._spec, self._distributions = spec, load_distributions(spec)
        model = load_pinocchio(spec)[0]
        self._dry, self._damping = np.array(model.friction), np.array(model.damping)
        self._kp, self.constant = drive_gains(spec).kp, nominal_windings(spec).constant
        self.gravity_model = DrawnGravity(spec, self._distributions)

    def scale(self, sweep: Sweep) -> Measured:
        """Encoder over setpoint."""
        error = SCALE + ERRORS * sweep.scale_error
        return Measured(sweep.scale, 1.0 - error, 1.0 + error)

    def delay(self, joint: int, sweep: Sweep) -> Measured:
        """Delay of the drive, s: of its commands, within a control period and what friction takes to overcome."""
        slack = self._spec.dt + self._friction(joint, sweep.speed)[1] / self._kp[joint] / sweep.speed
        return Measured(sweep.delay_s, -slack, self._distributions.drives.delay_s.high + slack)

    def age(self, sweep: Sweep) -> Measured:
        """Age of a packet on its arrival, s; it arrives in whole control periods."""
        errors = self._distributions.sensors
        longest = (errors.delay.high + errors.jitter.high) * self._spec.sensors["encoder"].delay_s
        return Measured(sweep.age_s, 0.0, longest + 2.0 * self._spec.dt)

    def tracking(self, sweep: Sweep) -> Measured:
        """Tracking error, rad."""
        return Measured(sweep.tracking_rad, 0.0, self._spec.margins.tracking_rad)

    def friction(self, joint: int, sweep: Sweep) -> Measured:
        """Friction at the joint, N·m; unbounded where the model has none."""
        low, high = self._friction(joint, sweep.speed)
        if high == 0.0:
            return Measured(sweep.friction, -np.inf, np.inf)
        error = ERRORS * sweep.torque_error
        return Measured(sweep.friction, low - error, high + error)

    def gravity(self, joint: int, sweep: Sweep, q: Floats) -> Measured:
        """Torque against gravity, N·m, at joint angles (n,) rad."""
        low, high = self.gravity_range(q)
        nominal, error = self.gravity_model.nominal(q)[joint], ERRORS * sweep.torque_error
        return Measured(nominal + sweep.gravity, low[joint] - error, high[joint] + error)

    def gravity_range(self, q: Floats) -> tuple[Floats, Floats]:
        """Return least and largest (n,) N·m that currents may show of gravity at joint angles (n,) rad."""
        drawn, sensor = self.gravity_model.drawn(q), self._spec.sensors["current"]
        bias = self._distributions.sensors.bias
        offset = sensor.bias * max(abs(bias.low), abs(bias.high)) * self.constant
        middle, spread = drawn.mean(axis=0), SPREAD * drawn.std(axis=0) + offset
        return middle - spread, middle + spread

    @property
    def friction_at_rest(self) -> Floats:
        """(n,) N·m that friction may hold of a joint at rest, either way."""
        return np.array([self._friction(joint, 0.0)[1] for joint in range(self._spec.n)])

    def _friction(self, joint: int, speed: float) -> tuple[float, float]:
        """Return least and largest friction of a joint, N·m, as nominal torque constants read it, worn or not."""
        joints, wear, motor = (
            self._distributions.joints,
            self._distributions.wear,
            self._distributions.drives.torque_constant,
        )
        dry, damping = self._dry[joint], self._damping[joint] * speed
        low = dry * joints.friction.low + damping * joints.damping.low
        high = dry * joints.friction.high * (1.0 + wear.friction.high) + damping * joints.damping.high
        return low / motor.high, high / (motor.low * (1.0 + wear.torque_constant.low))
