"""Search for stops that safety accepts and that come closer to limits of the tool, torque or clearance in between.

Safety looks at the beginning of a stop, at moments while it brakes and at its end. What lies between is left to the
margins of robot.toml: this is what they must cover, for any setpoint inside the limits, reachable or not.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import differential_evolution

from deploy.motion.smoother import Smoother
from deploy.safety.check import Limits
from deploy.safety.safety import Safety
from deploy.state import Setpoint, State, Stop
from robots.arrays import Bools, Floats
from robots.capabilities import required
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

POPULATION, GENERATIONS, SEED = 256, 300, 1
TICKS, STEEPNESS = 2, 10.0
"""Ticks between two looks at a stop; slope of the objective where safety refuses, so that the search comes back."""
GAP_SCALE_M = 1.0
"""m, of gaps as shares."""


class StopSearch:
    """Stops of P robots from any joint angle, speed and acceleration within their limits.

    Attributes:
        quantities: what is searched for, each a share of its limit; of the gap between shapes, `GAP_SCALE_M` minus it,
            as a share of that. bounds: of safety, for each.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Build the shipped smoother and safety."""
        self._spec, self._space, self._fleet = spec, spec.workspace, Fleet(spec, robots, collisions=True)
        self._smoother, self._all = Smoother(spec, robots), np.ones(robots, dtype=bool)
        self._safety = Safety(spec, Fleet(spec, 2 * robots, collisions=True))
        self._low, self._high = spec.joint_array("q_min"), spec.joint_array("q_max")
        self._torque_max, self.bounds = torque_max(spec), {"torque": spec.margins.tau}
        if self._space:
            wall = 1.0 - required(spec.margins.workspace_m) / self._space.radius_max
            speed = Limits(spec, self._torque_max).tool_speed / self._space.tool_speed_max
            self.bounds |= {"tool speed": speed, "tool depth": wall, "tool radius": wall}
        if "self_collision" in spec.capabilities:
            self.bounds["gap"] = 1.0 - required(spec.margins.collision_m) / GAP_SCALE_M
        self.quantities = tuple(self.bounds)

    def start(self, x: Floats) -> Setpoint:
        """Return setpoints for numbers x (P, 3n) from 0 to 1: angle, peak speed, acceleration."""
        place, speed, acceleration = np.split(x, 3, axis=1)
        qdd = (2 * acceleration - 1) * self._spec.joint_array("qdd_max")
        peak = (2 * speed - 1) * self._spec.margins.speed * self._spec.joint_array("qd_max")
        qd = peak - qdd * np.abs(qdd) / self._safety.twice_jerk
        return Setpoint(q=self._low + place * (self._high - self._low), qd=qd, qdd=qdd)

    def shares(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """(quantities, P) at angles, speeds and accelerations (P, n)."""
        shares = [np.abs(self._fleet.torque(q, qd, qdd) / self._torque_max).max(axis=1)]
        if space := self._space:
            kinematics = self._fleet.kinematics(q)
            tool, speed = kinematics.tool_position, np.linalg.norm(kinematics.tool_velocity(qd), axis=1)
            shares.append(speed / space.tool_speed_max)
            shares.append(1.0 + (space.z_min - tool[:, 2]) / space.radius_max)
            shares.append(np.linalg.norm(tool - np.array(space.centre), axis=1) / space.radius_max)
        if "gap" in self.bounds:
            shares.append(1.0 - self._fleet.least_gaps(q) / GAP_SCALE_M)
        return np.array(shares)

    def run(self, start: Setpoint) -> tuple[Floats, Floats, Bools]:
        """Return (quantities, P) largest shares at the checked moments and in the whole stop, and (P,) stops refused.

        Torque is checked at the setpoint and one step into its stop only.
        """
        stop, spec = self._smoother.brake(start), self._spec
        refused = self._safety.step(_at(start), start, start, stop).reason != 0
        still, ahead = np.zeros_like(start.qd), stop.ahead
        checked = [self.shares(each.q, each.qd, each.qdd) for each in (start, ahead)]
        at_moments = [self.shares(*each) for each in ((stop.q_rest, still, still), *self._moments(stop))]
        checked += [np.concatenate((np.zeros_like(each[:1]), each[1:])) for each in at_moments]
        whole, smoother = list(checked), self._smoother
        smoother.commit(start)
        for tick in range(round(spec.stop_s / spec.dt)):
            smoother.commit(smoother.next(start.q, self._all))
            if tick % TICKS == 0:
                whole.append(self.shares(smoother.q, smoother.qd, smoother.qdd))
        return np.max(checked, axis=0), np.max(whole, axis=0), refused

    @staticmethod
    def _moments(stop: Stop) -> Iterator[tuple[Floats, Floats, Floats]]:
        """Yield angles and speeds while a stop brakes, without acceleration: torque is not checked there."""
        for q, qd in zip(stop.q, stop.qd, strict=True):
            yield q, qd, np.zeros_like(q)

    def worst(self, quantity: str, generations: int, seed: int) -> float:
        """Return the largest share of a quantity in a stop that safety accepts; NaN where none was found.

        Source: Storn and Price, Differential Evolution (1997), by scipy.
        """
        row, bound, found = self.quantities.index(quantity), self.bounds[quantity], [np.nan]

        def loss(x: Floats) -> Floats:
            checked, whole, refused = self.run(self.start(x.T))
            found.extend(whole[row][~refused])
            excess = np.maximum(checked[row] - bound, 0.0)
            return np.asarray(refused * (1.0 + STEEPNESS * excess) - whole[row])

        first = np.random.default_rng(seed).random((len(self._all), 3 * self._spec.n))
        differential_evolution(
            loss,
            [(0.0, 1.0)] * first.shape[1],
            init=first,
            maxiter=generations,
            tol=0.0,
            polish=False,
            updating="deferred",
            vectorized=True,
            rng=seed,
        )
        return float(np.nanmax(found))


def stop_search(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print the worst accepted stop for torque, each limit of the tool, and 1 minus the gap between shapes, m."""
    del policy
    search = StopSearch(spec, POPULATION)
    table = Table("", "bound at the checked moments", "worst in between", title=f"stops of {spec.name}")
    for quantity, bound in search.bounds.items():
        worst = search.worst(quantity, GENERATIONS, SEED)
        table.add_row("1 − gap, m" if quantity == "gap" else quantity, f"{bound:.4f}", f"{worst:.4f}")
    console.print(table)


def _at(setpoint: Setpoint) -> State:
    """Return the estimate of robots that are where their setpoint is, with cool motors."""
    q, cool = setpoint.q, np.full_like(setpoint.q, 25.0)
    robots, still = len(q), np.zeros_like(q)
    return State(
        t=0.0,
        q=q,
        qd=setpoint.qd,
        q_var=still,
        age=np.zeros(robots),
        nis=np.ones_like(q),
        housing_c=cool,
        winding_c=cool,
        hottest_c=cool,
        current_share=np.ones_like(q),
        fault=np.zeros(robots, dtype=np.int64),
    )
