"""Trials: adversaries move robots of draws.toml, and the largest excess of each is kept."""

import gc
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from eval.attack.adversaries import ADVERSARIES
from eval.attack.arena import Setting, write_job
from eval.attack.candidate import Candidate
from eval.attack.crowd import Crowd
from eval.attack.island import FAR
from eval.attack.loaded_robots import DISTURBED, loaded_robots, loaded_shard
from eval.attack.policy_graph import policy_file
from eval.margins.excess import Excess, Values
from eval.replay.bundle import POLICY
from eval.shard.job import WIDTH
from eval.shard.shard import Shard
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.draws import Draw, shape
from robots.spec import RobotSpec, load_robot

TRIAL_S = 10.0
"""s of a trial; robots that latched are armed again after half a second."""
DRAWN = ("sensors", "climate", "wear")
"""Groups of draws.toml that are drawn as in a soak at the corners, too."""


class Trial(NamedTuple):
    """One trial of 16 robots that no other trial has, each with a policy of its own.

    Attributes:
        adversary: whose weights are varied at random. seed: of robots, disturbances, noise and weights.
        corners: as in `draw_robots`.
    """

    setting: Setting
    adversary: str
    seed: int
    corners: bool


class Outcome(NamedTuple):
    """Outcome of a trial.

    Attributes:
        excess: (`WIDTH`, bins) largest of each robot, by quantity.
        estimate_error: (2, n) rad and rad/s, standard deviation, of the worst robot.
        diverged: number of robots whose simulation diverged.
    """

    excess: Values
    estimate_error: Floats
    diverged: int


def run(trial: Trial) -> Outcome:
    """Simulate a trial and keep the largest excess of each robot."""
    gc.collect()  # earlier shards are in cycles, and their memory is MuJoCo's, which the collector does not count
    setting, spec = trial.setting, load_robot(trial.setting.robot)
    shard = make_shard(setting, draw_robots(spec, trial.seed, corners=trial.corners), trial.seed)
    rng = np.random.default_rng(trial.seed)
    policies = ADVERSARIES[trial.adversary].varied(spec.n, rng, FAR, WIDTH)
    shard.set_policy(Crowd(policy_file(spec, setting.mode, policies)))
    excess = Excess(shard.runtime, shard.robot.plant)
    for _ in range(round(TRIAL_S / spec.dt)):
        shard.tick()
        excess.step(shard.truth)
    return Outcome(excess.largest, excess.estimate_error, int((~shard.truth.valid).sum()))


def make_shard(setting: Setting, robots: Draw, seed: int) -> Shard:
    """Return a shard of robots from new to worn."""
    spec = load_robot(setting.robot)
    with TemporaryDirectory() as folder:
        return loaded_shard(write_job(setting, spec, Candidate("", {}, seed), Path(folder) / POLICY), robots)


def draw_robots(spec: RobotSpec, seed: int, *, corners: bool) -> Draw:
    """Return robots of `loaded_robots`; with `corners`, each mechanical quantity has its least or its most."""
    distributions, rng = load_distributions(spec), np.random.default_rng([seed, 1])
    extreme = {
        name: np.where(rng.random((WIDTH, *shape(quantity, spec))) < 0.5, span.low, span.high)
        for name, quantity, span in distributions.spans()
        if corners and not name.startswith((*DRAWN, *DISTURBED))
    }
    return loaded_robots(distributions, spec, seed).replaced(extreme)
