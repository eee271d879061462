"""Trials: adversaries move robots of draws.toml, and the largest excess of each is kept."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from deploy.backends.sim.disturbances import Pushes
from eval.attack.adversaries import ADVERSARIES
from eval.attack.arena import Setting, write_job
from eval.attack.candidate import Candidate
from eval.attack.crowd import Crowd
from eval.attack.island import FAR
from eval.attack.loaded_robots import CHOICE, DISTURBED, loaded_robots, loaded_shard
from eval.attack.policy_graph import policy_file
from eval.attack.throws import throws
from eval.margins.aimed_pushes import NOBODY, AimedPushes, Aims, Moment
from eval.margins.excess import Excess, Values
from eval.replay.bundle import POLICY
from eval.shard.job import WIDTH
from eval.shard.shard import Shard
from robots.arrays import Floats, Ints
from robots.distributions import Distributions, load_distributions
from robots.draws import Draw, draw, shape
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

TRIAL_S = 10.0
"""s of a trial; robots that latched are armed again after half a second."""
DRAWN = ("sensors", "climate", "wear")
"""Groups of draws.toml that are drawn as in a soak at the corners, too."""
AIMED = WIDTH // 2
"""First of the robots of a trial that are pushed along their motion, the more worn half; the others, by chance."""
_TURNS: tuple[tuple[Moment, bool], ...] = (
    *((Moment.FAST, True), (Moment.BRAKING, False), (Moment.FAST, False), (Moment.FAST, False)),
    *((Moment.STOPPING, True), (Moment.BRAKING, False), (Moment.FAST, False), (Moment.FAST, False)),
)
"""For each robot from `AIMED` on: the moment of its push, and True if it is along the motion of its tool."""
MOMENTS, OF_TOOL = np.array([moment for moment, _ in _TURNS]), np.array([tool for _, tool in _TURNS])
"""(WIDTH - AIMED,) columns of `_TURNS`."""
NEVER_S = 1e9
"""s, a pause that no trial reaches."""


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
    setting, spec = trial.setting, load_robot(trial.setting.robot)
    robots = draw_robots(spec, trial.seed, corners=trial.corners)
    shard = make_shard(setting, robots, trial.seed)
    rng = np.random.default_rng(trial.seed)
    policies = ADVERSARIES[trial.adversary].varied(spec.n, rng, FAR, WIDTH)
    shard.set_policy(Crowd(policy_file(spec, setting.mode, policies)))
    plant = shard.robot.plant
    excess, by_chance = Excess(shard.runtime, plant), plant.disturbances[Pushes.name]
    aimed = AimedPushes(spec, plant, robots, aims(spec, robots, trial.seed))
    supervisor = shard.runtime.supervisor
    for _ in range(round(TRIAL_S / spec.dt)):
        ran = supervisor.running
        shard.tick()
        planned = excess.step(shard.truth, by_chance.on | aimed.on)
        aimed.step(planned, shard.truth.q, shard.truth.qd, ran & ~supervisor.running)
    return Outcome(excess.largest, excess.estimate_error, int((~shard.truth.valid).sum()))


def make_shard(setting: Setting, robots: Draw, seed: int) -> Shard:
    """Return a shard of robots from new to worn."""
    spec = load_robot(setting.robot)
    with TemporaryDirectory() as folder:
        return loaded_shard(write_job(setting, spec, Candidate("", {}, seed), Path(folder) / POLICY), robots)


def draw_robots(spec: RobotSpec, seed: int, *, corners: bool) -> Draw:
    """Return robots of `loaded_robots`, and from `AIMED` on those of many that a push affects most.

    With `corners`, each mechanical quantity has its least or its most.
    """
    distributions, rng = load_distributions(spec), np.random.default_rng([seed, 1])
    loaded, thrown = loaded_robots(distributions, spec, seed), _thrown_robots(distributions, spec, seed)
    extreme = {
        name: np.where(rng.random((WIDTH, *shape(quantity, spec))) < 0.5, span.low, span.high)
        for name, quantity, span in distributions.spans()
        if corners and not name.startswith((*DRAWN, *DISTURBED))
    }
    both = {name: np.concatenate((values[:AIMED], thrown[name])) for name, values in loaded.items()}
    for name in ("payload.carried_s", "payload.free_s"):
        both[name] = loaded[name]
    return Draw(both).replaced(extreme)


def _thrown_robots(distributions: Distributions, spec: RobotSpec, seed: int) -> Draw:
    robots = draw(distributions, spec, [robot_seed(seed, robot) for robot in range(CHOICE * WIDTH)])
    found = throws(spec, robots)
    of_tool = OF_TOOL & (spec.workspace is not None)
    rows: list[int] = []
    for joint, moment, tool in zip(_joints_in_turn(spec, seed), MOMENTS, of_tool, strict=True):
        of_joint = (
            found.torque.max(axis=(1, 2)) if moment == Moment.BRAKING else found.speed[:, joint].max(axis=1)
        )
        effect = (found.tool if tool else of_joint).copy()
        effect[rows] = -np.inf
        rows.append(int(effect.argmax()))
    return robots.rows(np.array(rows)).replaced({"push.every_s": NEVER_S})


def _joints_in_turn(spec: RobotSpec, seed: int) -> Ints:
    """Return the joint of each robot of the second half along whose motion it is pushed, by a trial's seed."""
    joints: Ints = (np.arange(WIDTH - AIMED) + seed) % spec.n
    return joints


def aims(spec: RobotSpec, robots: Draw, seed: int) -> Aims:
    """Return the aims of a trial: joints in turn, or whose torque a push affects most, and tools that have limits."""
    found = throws(spec, robots)
    moments = np.concatenate((np.full(AIMED, Moment.FAST), MOMENTS))
    braked = moments == Moment.BRAKING
    joints = np.concatenate((np.zeros(AIMED, dtype=np.int64), _joints_in_turn(spec, seed)))
    joints[braked] = found.torque[braked].max(axis=2).argmax(axis=1)
    effect = np.where(braked[:, None, None], found.torque, found.speed)
    links = effect[np.arange(WIDTH), joints].argmax(axis=1)
    if spec.workspace:
        joints[AIMED:][OF_TOOL], links[AIMED:][OF_TOOL] = spec.n, spec.n - 1
    joints[:AIMED] = NOBODY
    return Aims(joints, links, moments)
