"""Search for stops that safety accepts and that come closer to limits of the tool, torque or clearance in between.

Safety looks at the beginning of a stop, at moments while it brakes and at its end. What lies between is left to the
margins of robot.toml: this is what they must cover, for any setpoint inside the limits, reachable or not.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from deploy.motion.ruckig_planner import RuckigPlanner
from deploy.motion.smoother import Smoother
from deploy.motion.trajectories import TrackingTrajectories
from deploy.safety.check import Limits
from deploy.safety.safety import Safety
from deploy.state import Setpoint, State
from eval.attack.island import evolution_strategy
from robots.arrays import Bools, Floats
from robots.capabilities import required
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

POPULATION, GENERATIONS, SEED = 256, 600, 1
ISLAND, DEVIATION = 16, 0.1
"""Stops of one generation of an island; the standard deviation of its first one, as a share of the ranges."""
STAGNATION, LEAST_GAIN = 20, 1e-4
"""Generations without a gain of that share of the limit, after which an island begins elsewhere."""
TICKS, STEEPNESS = 4, 4.0
"""Ticks between two looks at a stop; slope of the objective where safety refuses, so that the search comes back."""
UNPLANNED = 1e3
"""Loss of a stop that Ruckig does not plan."""
GAP_SCALE_M = 1.0
"""m, of gaps as shares."""


class StopSearch:
    """Stops of P robots, a multiple of `ISLAND`, from any joint angle, speed and acceleration within their limits.

    Attributes:
        quantities: what is searched for, each a share of its limit; of the gap between shapes, `GAP_SCALE_M` minus it,
            as a share of that. bounds: of safety, for each.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Build the shipped smoother and safety."""
        self._worst = np.nan
        self._spec, self._space, self._fleet = spec, spec.workspace, Fleet(spec, robots, collisions=True)
        self._smoother, self._robots = Smoother(spec, robots), robots
        self._stops = TrackingTrajectories(spec, robots, RuckigPlanner)
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

    def shares(self, quantities: Iterable[str], q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """(Q, P) of Q quantities at angles, speeds and accelerations (P, n)."""
        found, wanted = {}, set(quantities)
        if "torque" in wanted:
            found["torque"] = np.abs(self._fleet.torque(q, qd, qdd) / self._torque_max).max(axis=1)
        if (space := self._space) and wanted - {"torque", "gap"}:
            kinematics = self._fleet.kinematics(q)
            tool, speed = kinematics.tool_position, np.linalg.norm(kinematics.tool_velocity(qd), axis=1)
            found["tool speed"] = speed / space.tool_speed_max
            found["tool depth"] = 1.0 + (space.z_min - tool[:, 2]) / space.radius_max
            found["tool radius"] = np.linalg.norm(tool - np.array(space.centre), axis=1) / space.radius_max
        if "gap" in wanted:
            found["gap"] = 1.0 - self._fleet.least_gaps(q) / GAP_SCALE_M
        return np.array([found[name] for name in quantities])

    def run(self, start: Setpoint, quantity: str) -> tuple[Floats, Floats, Bools]:
        """Return (quantities, P) largest shares at checked moments, (P,) of one in the whole stop, and (P,) refusals.

        Torque is not checked where a stop ends.
        """
        stop, names = self._smoother.brake(start), self.quantities
        refused = self._safety.step(_at(start), start, start, stop).reason != 0
        moments = zip(stop.q, stop.qd, stop.qdd, strict=True)
        checked = [self.shares(names, *each) for each in (start[:3], stop.ahead[:3], *moments)]
        still = np.zeros_like(start.qd)
        at_rest = self.shares(names, stop.q_rest, still, still)
        at_rest[names.index("torque")] = 0.0
        most = np.max([*checked, at_rest], axis=0)
        return most, np.maximum(most[names.index(quantity)], self._between(start, quantity)), refused

    def _between(self, start: Setpoint, quantity: str) -> Floats:
        """Return (P,) the largest share of a quantity in stops, every few ticks until their end."""
        full = np.ones((len(start.q), 1))
        origin = (start.q, start.qd, start.qdd, start.q, full, full)
        self._stops.plan(np.concatenate(origin, axis=1))
        most = np.full(len(start.q), -np.inf)
        for tick in range(TICKS, round(self._spec.stop_s / self._spec.dt) + 1, TICKS):
            points = self._stops.at(np.full(len(start.q), tick)).swapaxes(0, 1)
            most = np.maximum(most, self.shares((quantity,), *points)[0])
        return most

    def worst(self, quantity: str, generations: int, seed: int) -> float:
        """Return the largest share of a quantity in a stop that safety accepts; NaN where none was found.

        Islands search side by side, each from the best of as many random stops as there are robots, and again from
        elsewhere when nothing is gained: stops that pass between the moments lie in many narrow places.
        """
        rng, self._worst = np.random.default_rng(seed), np.nan
        islands = [self._island(quantity, rng) for _ in range(self._robots // ISLAND)]
        for _ in range(generations):
            islands = [self._island(quantity, rng) if each.stagnates else each for each in islands]
            asked = [each.ask() for each in islands]
            loss = self._loss(quantity, np.concatenate(asked))
            for island, x, of_island in zip(islands, asked, loss.reshape(-1, ISLAND), strict=True):
                island.tell(x, of_island)
        return float(self._worst)

    def _island(self, quantity: str, rng: np.random.Generator) -> "_Island":
        x = rng.random((self._robots, 3 * self._spec.n))
        return _Island(x[self._loss(quantity, x).argmin()], rng)

    def _loss(self, quantity: str, x: Floats) -> Floats:
        """Return (P,) the loss of stops x (P, 3n), and remember the worst that is accepted."""
        bounds = np.array(list(self.bounds.values()))
        checked, whole, refused = self.run(self.start(x), quantity)
        excess = np.maximum(checked - bounds[:, None], 0.0).sum(axis=0)
        self._worst = np.fmax(self._worst, np.fmax.reduce(np.where(refused, np.nan, whole)))
        loss = STEEPNESS * excess + (refused & (excess == 0.0)) - whole
        return np.nan_to_num(loss, nan=UNPLANNED)


class _Island:
    """Search by CMA-ES for stops of least loss.

    Attributes:
        stagnates: nothing has been gained for `STAGNATION` generations.
    """

    def __init__(self, start: Floats, rng: np.random.Generator) -> None:
        self._strategy, self._best, self._idle = evolution_strategy(start, DEVIATION, ISLAND, rng), np.inf, 0

    @property
    def stagnates(self) -> bool:
        return self._idle >= STAGNATION or bool(self._strategy.stop())

    def ask(self) -> Floats:
        """Return the next generation, (ISLAND, 3n)."""
        return np.array(self._strategy.ask())

    def tell(self, x: Floats, loss: Floats) -> None:
        """Learn from the loss (ISLAND,) of a generation."""
        self._strategy.tell(list(x), loss.tolist())
        gained = loss.min() < self._best - LEAST_GAIN
        self._best, self._idle = (loss.min(), 0) if gained else (self._best, self._idle + 1)


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
