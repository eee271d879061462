"""Loaded robots: from new to worn, cold or hot, pushed often, half of them those of draws.toml with the most load."""

import numpy as np

from eval.shard.hot_motors import heat_motors
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from robots.arrays import Bools, Floats, Ints
from robots.distributions import Distributions
from robots.draws import Draw, draw
from robots.models.levers import joint_levers, levers_of_point, tool_levers
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.drive_gains import drive_gains
from robots.randomness import robot_seed
from robots.spec import RobotSpec

G = 9.81
"""m/s²."""
CHOICE = 8
"""Draws for each robot."""
PAUSE_S = 2.0
"""s between pushes, mean: a trial has some of them. By draws.toml they come 30 to 300 times less often."""
MOMENT_S, EVER_S = 0.1, 1e5
"""s with and without payload: a robot carries it all the time, or never."""
HOT = 0.25
"""Share of robots with hot motors, whose drives have less current and, without a loop around it, less stiffness."""
DISTURBED = ("push.every_s", "payload.carried_s", "payload.free_s")
"""Quantities of `loaded_robots` that are not drawn."""
LIVES = 2.0
"""Lives that the joints of a shard's last robot have used up, those of its first none: about two shifts."""


def loaded_shard(job: ShardJob, robots: Draw) -> Shard:
    """Return the shard of a job whose robots, from new to worn, replace those that its seed would draw."""
    shard = Shard(job, draw=robots)
    wear = shard.robot.plant.wear
    wear.life[:] = np.linspace(0.0, LIVES, WIDTH)[:, None]
    wear.apply()
    heat(shard, np.random.default_rng([job.seed, 2]).random(WIDTH) < HOT)
    return shard


def heat(shard: Shard, ids: Bools) -> None:
    """Heat the motors of robots `ids` (B,) before the first tick, as far as work may heat them.

    Housings and windings are halfway from the temperature of their warning to the one that ends the work.
    """
    spec = shard.runtime.spec
    housing, winding = (
        (spec.motor_array(f"{part}_soft_c") + spec.motor_array(f"{part}_max_c")) / 2.0
        for part in ("housing", "winding")
    )
    heat_motors(shard.runtime, shard.robot, ids, housing, np.maximum(winding - housing, 0.0))


def loaded_robots(distributions: Distributions, spec: RobotSpec, seed: int) -> Draw:
    """Return `WIDTH` robots, by turns one as drawn and one of those with the most load of many."""
    robots = draw(distributions, spec, [robot_seed(seed, robot) for robot in range(CHOICE * WIDTH)])
    robots = robots.rows(_first_and_heaviest(extra_load(spec, robots)))
    carried = np.where(np.random.default_rng(seed).random(WIDTH) < 0.5, EVER_S, MOMENT_S)
    return disturbed(robots, PAUSE_S, carried)


def disturbed(robots: Draw, pause_s: float, carried_s: Floats | float) -> Draw:
    """Return robots with s between pushes, that carry their payload for `EVER_S`, always, or `MOMENT_S`, never."""
    values: tuple[Floats | float, ...] = pause_s, carried_s, MOMENT_S * EVER_S / carried_s
    return robots.replaced(dict(zip(DISTURBED, values, strict=True)))


def _first_and_heaviest(load: Floats) -> Ints:
    """Return (WIDTH,) rows, by turns one of the first and one of those of the rest with the most load."""
    half = WIDTH // 2
    heaviest = half + np.argsort(-load[half:], kind="stable")
    rows: Ints = np.stack((np.arange(half), heaviest[:half]), axis=1).ravel()
    return rows


def extra_load(spec: RobotSpec, robots: Draw) -> Floats:
    """Return (B,) the largest share of a joint's range that extra mass, payload and a push take together."""
    return np.asarray((_extra_torque(spec, robots) / torque_max(spec)).max(axis=1))


def sag(spec: RobotSpec, robots: Draw) -> Floats:
    """Return (B,) m by which drives with their own gains let the end of an arm yield to that load."""
    kp = drive_gains(spec).kp * robots["drives.kp"]
    return np.asarray((_extra_torque(spec, robots) / kp) @ joint_levers(spec))


def _extra_torque(spec: RobotSpec, robots: Draw) -> Floats:
    """Return (B, n) N·m of extra mass, payload and a push.

    Forces act at their longest levers, in no pose at once: for comparing robots with each other.
    """
    model, _ = load_pinocchio(spec)
    masses = np.array([each.mass for each in model.inertias[1:]])
    arms = np.array(
        [
            levers_of_point(model, 1 + k, float(np.linalg.norm(model.inertias[1 + k].lever)))
            for k in range(spec.n)
        ]
    )
    tau = G * (masses * (robots["links.mass"] - 1.0)) @ arms
    tau += np.outer(G * robots["payload.mass_kg"] + robots["push.force_n"], tool_levers(spec, model))
    return np.asarray(tau)
