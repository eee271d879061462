"""How hot the windings are: nobody measures that, but current and housing are, and the motor's constants are known.

    Cw dTw/dt = I² R (1 + α (Tw − T0)) − (Tw − Th)/Rwh

The winding's node of `robots.motor`, with the measured housing Th around it. Heat is slow: current is squared on every
tick, the rest is done ten times a second.
"""

import numpy as np

from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import Packet, Sample
from robots.arrays import Bools, Floats
from robots.models.fleet import torque_max
from robots.sensors import Sensor
from robots.spec import RobotSpec
from robots.windings import nominal_windings

PERIOD_S = 0.1
"""s between two temperatures: windings have time constants of tens of seconds."""

STEPS, BACK = 20, 1.5
"""Steps of the foldback from nothing to all of it, each of which costs a new trajectory; and how many of them a motor
must have cooled before it gets one back, or it would go to and fro at every edge."""

LEAST_K = 0.1
"""K that the foldback has from nothing to all of it, however great the doubt."""

DEAF_S = 2.0
"""s without a whole packet of currents or housings after which nothing is known of a robot's windings any more."""

CREDIBLE = 1.5
"""Times the current that all of a joint's torque takes: as much as a reading counts for at most. No drive gives it."""

CHANCE = 1e-15
"""A current that says the same again and again is stuck once chance would bring that about so seldom."""


class Heat(Stage):
    """Observer of B × n windings, and how far each motor is folded back.

    Attributes:
        winding: (B, n) °C.
        hottest: (B, n) °C that it may have: what the housing's sensor may be off is added, and of the rise over the
            housing the share that nominal constants may miss.
        folded: (B, n) how far each motor is folded back: 0 up to the soft limit, from there in a straight line to 1
            where the robot stops: where the winding may have come to its hard limit.
        fold: (B, n) share of its current that a motor at work may still draw: down to `margins.fold_min`.
        pace: (B,) share of its speed and acceleration that a robot is still asked for, by its hottest motor: it falls
            to `margins.pace_min` as the current falls to `fold_min`, and lower, so that what is left of the current is
            enough for what is left of the motion.
        clear: (B, n) whether a joint's newest current and housing are numbers that move as a sensor's do.
    """

    carried = (
        "winding",
        "hottest",
        "folded",
        "fold",
        "pace",
        "rise",
        "last",
        "housing",
        "heard",
        "square",
        "unknown",
        "said",
        "same",
        "taken",
    )

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Nothing is known before the first sample.

        Raises:
            RobotError: a motor's winding is not described in model.xml.
        """
        shape = robots, spec.n
        self.winding, self.hottest, self.last, self.housing, self.said = np.full((5, *shape), np.nan)
        self.square, self.rise = np.zeros((2, *shape))
        self.same, self.clear = np.zeros(shape, dtype=np.int64), np.ones(shape, dtype=bool)
        self.heard, self.taken = np.full((2, robots), -np.inf)
        self.folded, self.fold, self.pace = np.zeros(shape), np.ones(shape), np.ones(robots)
        self.unknown = np.ones(robots, dtype=bool)
        self._every = max(1, round(PERIOD_S / spec.dt))
        self._motors = nominal_windings(spec)
        self._tau = self._motors.to_housing * self._motors.capacity
        self._soft = spec.motor_array("winding_soft_c")
        self._fold_min, self._pace_min = spec.margins.fold_min, spec.margins.pace_min
        self._hard = spec.motor_array("winding_max_c")
        self._doubt_k, self._doubt_share = spec.margins.winding_k, spec.margins.winding_share
        self._most = (CREDIBLE * torque_max(spec) / self._motors.constant) ** 2
        self._stuck = stuck_after(spec.sensors["current"])
        self._dt = spec.dt

    def resume(self, rise: Floats, off_s: float) -> None:
        """Windings were (B, n) K above their housings when the power went, so many s ago."""
        self.rise[:] = rise * np.exp(-off_s / self._tau)

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds: at their next whole sample they have been at rest for long."""
        self.unknown[ids], self.heard[ids], self.rise[ids] = True, -np.inf, 0.0
        for known in (self.winding, self.hottest, self.last, self.housing, self.said):
            known[ids] = np.nan
        self.same[ids], self.taken[ids] = 0, -np.inf

    def step(self, t: float, sample: Sample) -> None:
        """Live through a tick. Before the first sample with every current and housing no winding is known: NaN.

        Args:
            t: s, now.
            sample: the newest packets; what is no number in them counts as the last one that was.
        """
        current, housing = sample["current"], sample["temperature"]
        square = np.minimum(current.value * current.value, self._most)
        np.copyto(self.last, square, where=np.isfinite(square))
        self.square += self.last
        if any_true(self.unknown):
            self._begin(t, current, housing)
        if (round(t / self._dt) + 1) % self._every == 0:
            self._warm(housing.value)
            self._listen(t, current, housing)

    def _hear(self, t: float, current: Packet, housing: Packet) -> None:
        """When each robot's newest whole pair of packets was taken; none is believed to come from the future."""
        taken, latest = np.minimum(current.t, housing.t), np.maximum(current.t, housing.t)
        self.clear = np.isfinite(current.value + housing.value) & (self.same < self._stuck)
        np.copyto(self.heard, taken, where=self.clear.all(axis=1) & (latest <= t + self._dt))

    def _begin(self, t: float, current: Packet, housing: Packet) -> None:
        """Start with what is measured, where every joint of a robot is heard."""
        self._hear(t, current, housing)
        ready = self.unknown & (t - self.heard <= DEAF_S)
        ids = ready[:, None]
        # A housing that was not heard meanwhile may have cooled, but nobody saw its winding cool.
        np.copyto(self.winding, np.fmax(self.housing, housing.value) + self.rise, where=ids)
        np.copyto(self.housing, housing.value, where=ids)
        np.copyto(self.square, 0.0, where=ids)
        self.unknown &= ~ready
        self._fold_back()

    def _listen(self, t: float, current: Packet, housing: Packet) -> None:
        """Who has not been heard for long knows nothing; the rise is kept for when it is heard again."""
        new = (current.t > self.taken)[:, None]
        self.same += new
        np.copyto(self.same, 0, where=new & (current.value != self.said))
        np.copyto(self.said, current.value, where=new)
        np.copyto(self.taken, current.t, where=new[:, 0])
        self._hear(t, current, housing)
        deaf = (t - self.heard > DEAF_S) & ~self.unknown
        if any_true(deaf):
            self.rise[deaf] = (self.winding - self.housing)[deaf]
            self.winding[deaf], self.hottest[deaf] = np.nan, np.nan
            self.unknown[deaf], self.heard[deaf] = True, -np.inf

    def _warm(self, housing: Floats) -> None:
        """Live through the ticks since the last time with their mean I²."""
        np.copyto(self.housing, housing, where=np.isfinite(housing))
        m, share = self._motors, self._every * self._dt / self._tau
        loss = self.square / self._every * m.resistance * (1 + m.alpha * (self.winding - m.reference_c))
        self.winding += share * (loss * m.to_housing - (self.winding - self.housing))
        self.square[:] = 0.0
        self._fold_back()

    def _fold_back(self) -> None:
        """On by whole steps at once, back only by more than one."""
        doubt = np.maximum(self.winding - self.housing, 0.0) * self._doubt_share + self._doubt_k
        np.add(self.winding, doubt, out=self.hottest)
        share = (self.winding - self._soft) / np.maximum(self._hard - doubt - self._soft, LEAST_K)
        stepped = np.floor(np.clip(share, 0.0, 1.0) * STEPS) / STEPS
        stepped[np.isnan(share)] = 1.0
        cooled = share <= self.folded - BACK / STEPS
        np.copyto(self.folded, stepped, where=(stepped > self.folded) | cooled)
        np.subtract(1.0, (1.0 - self._fold_min) * self.folded, out=self.fold)
        np.subtract(1.0, (1.0 - self._pace_min) * self.folded.max(axis=1), out=self.pace)


def stuck_after(sensor: Sensor) -> float:
    """How often a reading may repeat itself: infinitely, where steps are too coarse for the noise to move it.

    Two readings of noise σ fall on the same step of width r with a chance of about r / (2 √π σ). Robots with half the
    noise of the data sheet are to be expected.
    """
    chance = sensor.resolution / (np.sqrt(np.pi) * sensor.noise) if sensor.noise else np.inf
    return float(np.ceil(np.log(CHANCE) / np.log(chance))) if chance < 1.0 else np.inf
