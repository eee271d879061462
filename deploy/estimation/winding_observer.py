"""Observer of winding temperatures: computed from measured current and measured housing temperature.

    Cw dTw/dt = I² R (1 + α (Tw − T0)) − (Tw − Th)/Rwh

The winding's node of `robots.motors.motor`, around it the measured housing Th. Heat is slow: the squared current is
summed on every tick, the temperature is integrated ten times a second.
"""

import numpy as np

from deploy.estimation.foldback import Foldback
from deploy.estimation.sample_count import sample_count
from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import Packet, Sample
from robots.arrays import Bools, Floats
from robots.models.nominal_model import torque_max
from robots.motors.windings import nominal_windings
from robots.sensors import Sensor
from robots.spec import RobotSpec

PERIOD_S = 0.1
"""s between two integration steps: windings have time constants of tens of seconds."""
TIMEOUT_S = 2.0
"""s without a valid packet of currents or housing temperatures after which a robot's windings are unknown."""
CURRENT_MAX = 1.5
"""A reading counts at most as this multiple of the current at the joint's largest torque: no drive gives more."""
STUCK_CHANCE = 1e-15
"""A current sensor is stuck when its number of equal readings in a row has a probability below this."""


class WindingObserver(Stage):
    """Temperatures of B × n windings.

    Attributes:
        winding: (B, n) °C, NaN while unknown. housing: (B, n) °C, last valid reading.
        hottest: (B, n) °C, upper bound of `winding`: margins for the housing's sensor, and for the error of nominal
            constants as a share of the rise above the housing.
        rise: (B, n) K, winding above housing when it was last known.
        square: (B, n) A², sum of I² since the last integration step. last_square: (B, n) A², last valid I².
        unknown: (B,) robots whose windings are unknown. t_valid: (B,) s, when their last valid packets were taken.
        current: (B, n) A, last reading. repeats: (B, n) times it was repeated. t_current: (B,) s, when it was taken.
        valid: (B, n) joints whose newest current and housing are finite and not stuck.
    """

    carried = (
        *("winding", "housing", "hottest", "rise", "square", "last_square"),
        *("unknown", "t_valid", "current", "repeats", "t_current"),
    )
    parts = ("foldback",)

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Allocate; nothing is known before the first sample.

        Raises:
            RobotError: a motor's winding is not described in model.xml.
        """
        shape = robots, spec.n
        self.winding, self.housing, self.hottest, self.last_square, self.current = np.full(
            (5, *shape), np.nan
        )
        self.square, self.rise = np.zeros((2, *shape))
        self.repeats, self.valid = np.zeros(shape, dtype=np.int64), np.ones(shape, dtype=bool)
        self.t_valid, self.t_current = np.full((2, robots), -np.inf)
        self.unknown = np.ones(robots, dtype=bool)
        self.foldback = Foldback(spec, robots)
        self.margin_k, self.margin_share = spec.margins.winding_k, spec.margins.winding_share
        self.stuck_repeats = stuck_repeats(spec.sensors["current"])
        self._dt, self._period = spec.dt, sample_count(PERIOD_S, spec.dt)
        self._motors = nominal_windings(spec)
        self._tau = self._motors.to_housing * self._motors.capacity
        self._square_max = (CURRENT_MAX * torque_max(spec) / self._motors.constant) ** 2

    def resume(self, rise: Floats, off_s: float) -> None:
        """Start windings (B, n) K above their housings when power was lost, `off_s` ago."""
        self.rise[:] = rise * np.exp(-off_s / self._tau)

    def reset(self, ids: Bools) -> None:
        """Forget robots `ids` (B,): at their next valid sample their windings are as warm as their housings."""
        self.unknown[ids], self.t_valid[ids], self.rise[ids] = True, -np.inf, 0.0
        for known in (self.winding, self.housing, self.hottest, self.last_square, self.current):
            known[ids] = np.nan
        self.repeats[ids], self.t_current[ids] = 0, -np.inf

    def step(self, t: float, sample: Sample) -> None:
        """Advance to `t` s; a reading that is not finite counts as the last one that was."""
        current, housing = sample["current"], sample["temperature"]
        square = np.minimum(current.value * current.value, self._square_max)
        np.copyto(self.last_square, square, where=np.isfinite(square))
        self.square += self.last_square
        if any_true(self.unknown):
            self._begin(t, current, housing)
        if (round(t / self._dt) + 1) % self._period == 0:
            self._integrate(housing.value)
            self.check_sensors(t, current, housing)

    def _begin(self, t: float, current: Packet, housing: Packet) -> None:
        """Start robots with unknown windings where all joints have valid packets."""
        self._validate(t, current, housing)
        ready = self.unknown & (t - self.t_valid <= TIMEOUT_S)
        ids = ready[:, None]
        # A housing may have cooled while there were no packets, but the cooling of its winding was not observed.
        np.copyto(self.winding, np.fmax(self.housing, housing.value) + self.rise, where=ids)
        np.copyto(self.housing, housing.value, where=ids)
        np.copyto(self.square, 0.0, where=ids)
        self.unknown &= ~ready
        self._bound()

    def _validate(self, t: float, current: Packet, housing: Packet) -> None:
        """Renew `valid` and `t_valid`; packets from the future are not accepted."""
        oldest, newest = np.minimum(current.t, housing.t), np.maximum(current.t, housing.t)
        self.valid = np.isfinite(current.value + housing.value) & (self.repeats < self.stuck_repeats)
        np.copyto(self.t_valid, oldest, where=self.valid.all(axis=1) & (newest <= t + self._dt))

    def check_sensors(self, t: float, current: Packet, housing: Packet) -> None:
        """Count equal currents; windings are unknown after `TIMEOUT_S` without valid packets, their rise is kept."""
        new = (current.t > self.t_current)[:, None]
        self.repeats += new
        np.copyto(self.repeats, 0, where=new & (current.value != self.current))
        np.copyto(self.current, current.value, where=new)
        np.copyto(self.t_current, current.t, where=new[:, 0])
        self._validate(t, current, housing)
        lost = (t - self.t_valid > TIMEOUT_S) & ~self.unknown
        if any_true(lost):
            self.rise[lost] = (self.winding - self.housing)[lost]
            self.winding[lost], self.hottest[lost] = np.nan, np.nan
            self.unknown[lost], self.t_valid[lost] = True, -np.inf

    def _integrate(self, housing: Floats) -> None:
        """Integrate the ticks since the last step with their mean I² (explicit Euler)."""
        np.copyto(self.housing, housing, where=np.isfinite(housing))
        m, share = self._motors, self._period * self._dt / self._tau
        loss = self.square / self._period * m.resistance * (1 + m.alpha * (self.winding - m.reference_c))
        self.winding += share * (loss * m.to_housing - (self.winding - self.housing))
        self.square[:] = 0.0
        self._bound()

    def _bound(self) -> None:
        margin = np.maximum(self.winding - self.housing, 0.0) * self.margin_share + self.margin_k
        np.add(self.winding, margin, out=self.hottest)
        self.foldback.step(self.winding, margin)


def stuck_repeats(sensor: Sensor) -> float:
    """Return the number of equal readings in a row of a stuck sensor; infinite where noise is too small to change them.

    Two readings with noise σ fall on the same step of width r with a probability of about r / (2 √π σ). Half the noise
    of the data sheet is to be expected.
    """
    inverse = np.sqrt(np.pi) * sensor.noise / sensor.resolution
    return float(np.ceil(-np.log(STUCK_CHANCE) / np.log(inverse))) if inverse > 1.0 else np.inf
