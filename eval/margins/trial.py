"""Trials: adversaries move robots of draws.toml, and the largest excess of each is kept."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from eval.attack.adversaries import ADVERSARIES
from eval.attack.arena import Setting, write_job
from eval.attack.candidate import Candidate
from eval.attack.crowd import Crowd
from eval.attack.island import FAR
from eval.attack.policy_graph import policy_file
from eval.attack.weights import Weights
from eval.margins.excess import Excess, Values
from eval.margins.tape import Tape
from eval.replay.bundle import POLICY
from eval.shard.job import WIDTH
from eval.shard.shard import Shard
from robots.arrays import Float32s, Floats
from robots.distributions import load_distributions
from robots.draws import Draw, draw, shape
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

TRIAL_S = 10.0
"""s of a trial; robots that latched are armed again after half a second."""
PAUSE_S = 2.0
"""s between pushes, mean: a trial has some of them. By draws.toml they come 30 to 300 times less often."""
MOMENT_S, EVER_S = 0.01, 1e4
"""s with and without payload: a robot carries it all the time, or never."""
LIVES = 2.0
"""Lives that the joints of the last robot of a shard have used up, those of the first none: about two shifts."""
DRAWN = ("sensors", "climate", "wear")
"""Groups of draws.toml that are drawn as in a soak at the corners, too."""


class Trials(NamedTuple):
    """Trials of one adversary on the robots of one seed.

    Attributes:
        number: of trials, in each of which every robot has a policy of its own. corners: as in `draw_robots`.
    """

    setting: Setting
    adversary: str
    seed: int
    number: int
    corners: bool


class Tried(NamedTuple):
    """Outcome of trials.

    Attributes:
        excess: (number × `WIDTH`, bins) largest of each robot in each trial, by quantity.
        policies: weights, in this order.
    """

    trials: Trials
    excess: Values
    policies: tuple[Weights, ...]


class Worst(NamedTuple):
    """One robot of one trial."""

    setting: Setting
    seed: int
    corners: bool
    policy: Weights
    robot: int


def run(trials: Trials) -> Tried:
    """Try policies."""
    setting, spec = trials.setting, load_robot(trials.setting.robot)
    adversary = ADVERSARIES[trials.adversary]
    rng = np.random.default_rng([trials.seed, *trials.adversary.encode()])
    shard = make_shard(setting, draw_robots(spec, trials.seed, corners=trials.corners), trials.seed)
    policies = [adversary.varied(spec.n, rng, FAR, WIDTH) for _ in range(trials.number)]
    found = []
    start = shard.snapshot()
    for rows in policies:
        shard.restore(start)
        shard.set_policy(Crowd(policy_file(spec, setting.mode, rows)))
        found.append(largest_excess(shard))
    excess = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    return Tried(trials, excess, tuple(row for rows in policies for row in rows))


def replay(worst: Worst, seeds: Sequence[int]) -> Values:
    """Return the largest excess (seeds × `WIDTH`, bins) of one robot under the actions of its trial, by quantity.

    Noise, losses and delays of samples differ each time, and nothing pushes.
    """
    setting, spec = worst.setting, load_robot(worst.setting.robot)
    robots = draw_robots(spec, worst.seed, corners=worst.corners)
    actions = _record(make_shard(setting, robots, worst.seed), worst, spec)
    one = robots.robot(worst.robot)
    same = Draw({name: np.repeat(values, WIDTH, axis=0) for name, values in one.items()})
    found = []
    for seed in seeds:
        shard = make_shard(setting, same.replaced({"push.every_s": EVER_S}), seed, lives_of=worst.robot)
        shard.set_policy(Tape(shard.runtime.contract, actions))
        found.append(largest_excess(shard))
    return {name: np.concatenate([each[name] for each in found]) for name in found[0]}


def _record(shard: Shard, worst: Worst, spec: RobotSpec) -> Float32s:
    """Run a trial again; return the actions (steps, A) of one robot."""
    shard.set_policy(Crowd(policy_file(spec, worst.setting.mode, [worst.policy] * WIDTH)))
    actions = []
    for _ in range(round(TRIAL_S / spec.dt)):
        shard.tick()
        if shard.action is not None:
            actions.append(shard.action[worst.robot].copy())
    return np.array(actions, dtype=np.float32)


def largest_excess(shard: Shard) -> Values:
    """Run a trial; return the largest excess (`WIDTH`, bins) of each robot, by quantity."""
    excess = Excess(shard.runtime, shard.robot.plant)
    for _ in range(round(TRIAL_S / shard.runtime.spec.dt)):
        shard.tick()
        excess.step(shard.truth)
    return excess.largest


def make_shard(setting: Setting, robots: Draw, seed: int, *, lives_of: int | None = None) -> Shard:
    """Return a shard of robots from new to worn, or all as worn as one of them."""
    spec = load_robot(setting.robot)
    with TemporaryDirectory() as folder:
        shard = Shard(write_job(setting, spec, Candidate("", {}, seed), Path(folder) / POLICY), draw=robots)
    wear, lives = shard.robot.plant.wear, np.linspace(0.0, LIVES, WIDTH)
    wear.life[:] = lives[:, None] if lives_of is None else lives[lives_of]
    wear.apply()
    return shard


def draw_robots(spec: RobotSpec, seed: int, *, corners: bool) -> Draw:
    """Return robots of draws.toml that are pushed often, and carry their payload all the time or never.

    With `corners`, each mechanical quantity has the least or the most that draws.toml allows.
    """
    distributions, rng = load_distributions(spec), np.random.default_rng(seed)
    robots = draw(distributions, spec, [robot_seed(seed, robot) for robot in range(WIDTH)])
    extreme = {
        name: np.where(rng.random((WIDTH, *shape(quantity, spec))) < 0.5, span.low, span.high)
        for name, quantity, span in distributions.spans()
        if corners and not name.startswith(DRAWN)
    }
    carried = np.where(rng.random(WIDTH) < 0.5, EVER_S, MOMENT_S)
    disturbed: dict[str, Floats | float] = {
        "push.every_s": PAUSE_S,
        "payload.carried_s": carried,
        "payload.free_s": MOMENT_S * EVER_S / carried,
    }
    return robots.replaced(extreme | disturbed)
