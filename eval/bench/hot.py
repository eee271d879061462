"""Whether the heat guard holds: the robots that run hottest, in a hot room under a heavy load, with it and without."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from deploy.estimation.estimator import Estimator
from deploy.runtime import Runtime
from deploy.state import Sample, Setpoint, State
from eval.bench.ablation import Unguarded
from eval.bench.trial import Trial
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.randomness import robot_seed
from robots.spec import RobotSpec
from robots.windings import Windings, nominal_windings

SEED, TRIED, TRIED_S = 11, 64, 60.0
ROBOTS, LIVED_S = 8, 2400.0
HOTTER_K, HEAVIER = 15.0, 1.2
BELOW_K = 5.0
"""K below the limit of its housing at which a robot may begin: any nearer, and its thermistor may not let it."""


class Careless(Estimator):
    """Nobody heeds heat: housings are said to be at 0 °C, and windings with them."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """As ever, with another stage for heat."""
        super().__init__(spec, robots)
        self.windings = Unguarded(spec, robots)

    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """The estimate, but for what is warm."""
        state = super().step(t, sample, sent)
        cold = np.zeros_like(state.temperature)
        return state._replace(temperature=cold, winding=cold, hottest=cold)


def _guarded(runtime: Runtime) -> None:
    """Leave all as it is."""


def _careless(runtime: Runtime) -> None:
    runtime.estimator = Careless(runtime.spec, runtime.robot.robots)


VARIANTS: dict[str, Callable[[Runtime], None]] = {"with the guard": _guarded, "without": _careless}


@dataclass(frozen=True, slots=True, kw_only=True)
class Heated:
    """What B robots went through.

    Attributes:
        winding: (B,) °C, the hottest true winding.
        margin: (B,) K, the least that a true winding stayed below its hard limit.
        folded: (B,) share of the time. reached, attempted, stops: (B,) goals, and times that the work was left.
    """

    winding: Floats
    margin: Floats
    folded: Floats
    reached: NDArray[np.int64]
    attempted: NDArray[np.int64]
    stops: NDArray[np.int64]

    def row(self, robot: int) -> tuple[str, ...]:
        """One robot, in words of the table."""
        warm = (self.winding, self.margin, 100 * self.folded)
        winding, margin, folded = (f"{values[robot]:.1f}" for values in warm)
        goals = f"{self.reached[robot]} of {self.attempted[robot]}"
        return winding, margin, goals, folded, str(self.stops[robot])


def hot(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Find the hottest, and let them work."""
    winding, housing = _steady(spec, policy)
    who = np.argsort(-winding.max(axis=1))[:ROBOTS]
    given = _warmed(spec, hot_draw(spec, who), housing[who].max(axis=1))
    found = {name: _work(spec, policy, who, given, swap) for name, swap in VARIANTS.items()}
    table = Table(
        *("robot", "steady, °C", "", "hottest winding, °C", "below its limit, K"),
        *("goals", "folded back, %", "stops"),
        title=f"The {ROBOTS} hottest of {TRIED}, {HOTTER_K:g} K warmer, loads x {HEAVIER:g}: {LIVED_S / 60:g} min each",
    )
    for row, robot in enumerate(who):
        for name, heated in found.items():
            table.add_row(str(robot), f"{winding[robot].max():.0f}", name, *heated.row(row))
    console.print(table)
    held, passed = (np.flatnonzero(heated.margin <= 0) for heated in found.values())
    console.print(
        f"windings beyond their hard limit: {len(held)} robots with the guard, {len(passed)} without;"
        f" steady is what each would come to without it, by what it lost in {TRIED_S:g} s"
    )


def hot_draw(spec: RobotSpec, who: Sequence[int] | NDArray[np.int64]) -> Draw:
    """Robots `who` of the seed, in a hotter room and under a heavier load."""
    usual = draw(load_distributions(spec), spec, _seeds(who))
    loads = {name: HEAVIER * usual[name] for name in ("links.mass", "payload.mass_kg")}
    return usual.replaced({**loads, "climate.ambient_c": usual["climate.ambient_c"] + HOTTER_K})


def _seeds(who: Sequence[int] | NDArray[np.int64]) -> list[np.random.SeedSequence]:
    return [robot_seed(SEED, int(robot)) for robot in who]


def _warmed(spec: RobotSpec, given: Draw, housing: Floats) -> Draw:
    """The same robots, begun as warm as their hottest housing (B,) °C comes to, or as the guard lets them begin."""
    begin = np.minimum(housing, spec.motor_array("housing_max_c").min() - BELOW_K)
    return given.replaced({"climate.warm_start_k": np.maximum(begin - given["climate.ambient_c"], 0.0)})


def _steady(spec: RobotSpec, policy: Path) -> tuple[Floats, Floats]:
    """(TRIED, n) °C that windings and housings come to where nobody heeds them, by what they lose in a short while."""
    who = range(TRIED)
    given = hot_draw(spec, who)
    trial = Trial(spec, policy, _seeds(who), given=given)
    _careless(trial.runtime)
    plant, motors, first = trial.robot.plant, nominal_windings(spec), trial.robot.truth()
    begin, ticks = first.housing_c.copy(), round(TRIED_S / spec.dt)
    copper, rise, housing = np.zeros((3, TRIED, spec.n))
    for _ in trial.live(TRIED_S):
        truth = trial.robot.truth()
        copper += trial.copper_w() / (1 + motors.alpha * (truth.winding_c - motors.reference_c)) / ticks
        rise += (truth.winding_c - truth.housing_c) / ticks
        housing += truth.housing_c / ticks
    ambient = given["climate.ambient_c"][:, None]
    out, away = plant.windings.to_housing, plant.housings.to_ambient
    # What warmed the housing, beside its winding and less what left it, is friction and iron.
    warming = plant.housings.capacity * (truth.housing_c - begin) / TRIED_S
    rubbed = warming - rise / out + (housing - ambient) / away
    return steady(copper, rubbed, ambient, motors, out, away)


def steady(
    copper: Floats, rubbed: Floats, ambient: Floats, motors: Windings, out: Floats, away: Floats
) -> tuple[Floats, Floats]:
    """(B, n) °C of windings and of housings that have lost the same for ever.

    Both nodes of `robots.motor` at rest.

    Args:
        copper: (B, n) W of the windings at their reference temperature. rubbed: (B, n) W into the housings.
        ambient: (B, 1) °C.
        motors: what windings of any draw have in common. out, away: (B, n) K/W from winding to housing, and on to
            ambient.
    """
    to_room = (out + away) * copper
    above = ambient + away * rubbed + to_room * (1 - motors.alpha * motors.reference_c)
    winding = above / (1 - to_room * motors.alpha)
    loss = copper * (1 + motors.alpha * (winding - motors.reference_c))
    return winding, winding - out * loss


def _work(
    spec: RobotSpec, policy: Path, who: NDArray[np.int64], given: Draw, swap: Callable[[Runtime], None]
) -> Heated:
    """A hot shift."""
    trial = Trial(spec, policy, _seeds(who), given=given)
    swap(trial.runtime)
    hottest, folded = np.full((len(who), spec.n), -np.inf), np.zeros(len(who), dtype=np.int64)
    for _ in trial.live(LIVED_S):
        np.maximum(hottest, trial.robot.truth().winding_c, out=hottest)
        folded += (trial.runtime.command.current < 1.0).any(axis=1)
    counts = trial.judge.counts()
    return Heated(
        winding=hottest.max(axis=1),
        margin=(spec.motor_array("winding_max_c") - hottest).min(axis=1),
        folded=np.asarray(folded * spec.dt / LIVED_S),
        reached=counts.reached,
        attempted=counts.attempted,
        stops=counts.stops,
    )
