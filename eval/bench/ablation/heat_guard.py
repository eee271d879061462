"""Heat guard at its limit: the hottest robots, in a hot room under heavy loads, with the guard and without."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from eval.bench.ablation.stage_variants import HeatBlindEstimator, Variant, keep_stages, replace_stage
from eval.bench.trial import Trial
from robots.arrays import Floats, Ints
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.motors.windings import Windings, nominal_windings
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED, CANDIDATES, CANDIDATE_S = 11, 64, 60.0
ROBOTS, TRIAL_S = 8, 2400.0
AMBIENT_RISE_K, LOAD_FACTOR = 15.0, 1.2
START_MARGIN_K = 5.0
"""K below the limit of its housing at which a robot may start. Any nearer, and its thermistor may refuse it."""

ignore_heat = replace_stage("estimator", HeatBlindEstimator)
VARIANTS: dict[str, Variant] = {"with the guard": keep_stages, "without": ignore_heat}


@dataclass(frozen=True, slots=True, kw_only=True)
class HeatResults:
    """Heat and work of B robots in one trial.

    Attributes:
        winding: (B,) °C, hottest true winding.
        margin: (B,) K, smallest distance of a true winding from its hard limit.
        folded: (B,) share of the time with current foldback. reached, attempted: (B,) goals. stops: (B,).
    """

    winding: Floats
    margin: Floats
    folded: Floats
    reached: Ints
    attempted: Ints
    stops: Ints

    def row(self, robot: int) -> tuple[str, ...]:
        """Return one robot's cells of the table."""
        columns = self.winding, self.margin, 100 * self.folded
        winding, margin, folded = (f"{values[robot]:.1f}" for values in columns)
        goals = f"{self.reached[robot]} of {self.attempted[robot]}"
        return winding, margin, goals, folded, str(self.stops[robot])


def heat_guard(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Find the hottest robots and print their trials with the guard and without."""
    winding, housing = _steady_temperatures(spec, policy)
    robots = np.argsort(-winding.max(axis=1))[:ROBOTS]
    drawn = warm_start(spec, hot_draw(spec, robots), housing[robots].max(axis=1))
    results = {name: _run(spec, policy, robots, drawn, variant) for name, variant in VARIANTS.items()}
    console.print(_table(robots, winding, results))
    guarded, unguarded = (np.count_nonzero(result.margin <= 0) for result in results.values())
    console.print(
        f"windings beyond their hard limit: {guarded} robots with the guard, {unguarded} without;"
        f" steady: extrapolated without the guard from the losses in {CANDIDATE_S:g} s"
    )


def _table(robots: Ints, winding: Floats, results: Mapping[str, HeatResults]) -> Table:
    table = Table(
        *("robot", "steady, °C", "", "hottest winding, °C", "below its limit, K"),
        *("goals", "folded back, %", "stops"),
        title=f"The {ROBOTS} hottest of {CANDIDATES}, {AMBIENT_RISE_K:g} K warmer, loads x {LOAD_FACTOR:g}:"
        f" {TRIAL_S / 60:g} min each",
    )
    for row, robot in enumerate(robots):
        for name, result in results.items():
            table.add_row(str(robot), f"{winding[robot].max():.0f}", name, *result.row(row))
    return table


def hot_draw(spec: RobotSpec, robots: Sequence[int] | Ints) -> Draw:
    """Draw robots of the seed by number, in a hotter room and under a heavier load."""
    usual = draw(load_distributions(spec), spec, _seeds(robots))
    loads = {name: LOAD_FACTOR * usual[name] for name in ("links.mass", "payload.mass_kg")}
    return usual.replaced({**loads, "climate.ambient_c": usual["climate.ambient_c"] + AMBIENT_RISE_K})


def _seeds(robots: Sequence[int] | Ints) -> list[np.random.SeedSequence]:
    return [robot_seed(SEED, int(robot)) for robot in robots]


def warm_start(spec: RobotSpec, drawn: Draw, housing: Floats) -> Draw:
    """Return the robots started at the temperature of their hottest housing (B,) °C, or just below its limit."""
    start = np.minimum(housing, spec.motor_array("housing_max_c").min() - START_MARGIN_K)
    return drawn.replaced({"climate.warm_start_k": np.maximum(start - drawn["climate.ambient_c"], 0.0)})


def _steady_temperatures(spec: RobotSpec, policy: Path) -> tuple[Floats, Floats]:
    """Extrapolate windings and housings, (CANDIDATES, n) °C, from the losses of a short trial without the guard."""
    robots = range(CANDIDATES)
    drawn = hot_draw(spec, robots)
    trial = Trial(spec, policy, _seeds(robots), draw=drawn)
    ignore_heat(trial.runtime)
    plant, motors, first = trial.robot.plant, nominal_windings(spec), trial.robot.truth()
    start, ticks = first.housing_c.copy(), round(CANDIDATE_S / spec.dt)
    copper, rise, housing = np.zeros((3, CANDIDATES, spec.n))
    for _ in trial.advance(CANDIDATE_S):
        truth = trial.robot.truth()
        copper += trial.copper_loss() / (1 + motors.alpha * (truth.winding_c - motors.reference_c)) / ticks
        rise += (truth.winding_c - truth.housing_c) / ticks
        housing += truth.housing_c / ticks
    ambient = drawn["climate.ambient_c"][:, None]
    to_housing, to_ambient = plant.windings.to_housing, plant.housings.to_ambient
    # Heat into the housing, less that from its winding, plus that to the room, is friction and iron loss.
    warming = plant.housings.capacity * (truth.housing_c - start) / CANDIDATE_S
    friction = warming - rise / to_housing + (housing - ambient) / to_ambient
    return steady(copper, friction, ambient, motors, to_housing, to_ambient)


def steady(
    copper: Floats,
    friction: Floats,
    ambient: Floats,
    motors: Windings,
    to_housing: Floats,
    to_ambient: Floats,
) -> tuple[Floats, Floats]:
    """Return steady temperatures (B, n) °C of windings and housings under constant losses.

    Both nodes of `robots.motors.motor` in equilibrium.

    Args:
        copper: (B, n) W of the windings at their reference temperature. friction: (B, n) W into the housings.
        ambient: (B, 1) °C.
        motors: nominal windings. to_housing, to_ambient: (B, n) K/W from winding to housing and from there to ambient.
    """
    to_room = (to_housing + to_ambient) * copper
    above = ambient + to_ambient * friction + to_room * (1 - motors.alpha * motors.reference_c)
    winding = above / (1 - to_room * motors.alpha)
    loss = copper * (1 + motors.alpha * (winding - motors.reference_c))
    return winding, winding - to_housing * loss


def _run(spec: RobotSpec, policy: Path, robots: Ints, drawn: Draw, variant: Variant) -> HeatResults:
    trial = Trial(spec, policy, _seeds(robots), draw=drawn)
    variant(trial.runtime)
    hottest, folded = np.full((len(robots), spec.n), -np.inf), np.zeros(len(robots), dtype=np.int64)
    for _ in trial.advance(TRIAL_S):
        np.maximum(hottest, trial.robot.truth().winding_c, out=hottest)
        folded += (trial.runtime.command.current_share < 1.0).any(axis=1)
    counts = trial.judge.counts()
    return HeatResults(
        winding=hottest.max(axis=1),
        margin=(spec.motor_array("winding_max_c") - hottest).min(axis=1),
        folded=np.asarray(folded * spec.dt / TRIAL_S),
        reached=counts.reached,
        attempted=counts.attempted,
        stops=counts.stops,
    )
