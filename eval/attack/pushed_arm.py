"""Pushed arm: of many arms the one that a push affects most, in copies with a push and drive gains of their own.

A push of draws.toml has a random moment and direction. Here a candidate chooses both: which push a robot gets is a
function of the number of its phase, and of many phases the one with the most similar direction is taken.
"""

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from deploy.backends.sim.disturbances import Pushes
from deploy.policy.gain_bounds import damping_bounds, stiffness_bounds
from eval.attack.adversaries import Effect
from eval.attack.loaded_robots import EVER_S, LIVES, MOMENT_S, disturbed, extra_load
from eval.attack.throws import throws
from eval.attack.trained_gains import STIFFEST, TrainedGains
from eval.attack.weights import Weights
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from robots.arrays import Floats, Ints
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from robots.spec import RobotSpec

ARMS = 8000
"""Arms of which one is chosen."""
PHASES = 4096
"""Pushes of which one is chosen, about 700 for each link of arm6: one within 0.2 rad of any direction, mean 0.07."""
NEVER_S = 1e6
"""s between pushes, mean: a trial has one."""


class Choice(NamedTuple):
    """Arm of a seed.

    Attributes:
        robots: `WIDTH` copies of it, without pushes by chance. link: that is pushed.
    """

    robots: Draw
    link: int


def choose_arm(spec: RobotSpec, effect: Effect, seed: int) -> Choice:
    """Return the arm of `ARMS` on which a push has the most effect: of loads with its payload, of throws without.

    Throws are those of one joint, by the seed: of the half of all joints that a push may throw fastest.
    """
    robots = draw(load_distributions(spec), spec, [robot_seed(seed, robot) for robot in range(ARMS)])
    link, carried = spec.n - 1, MOMENT_S
    if effect == "load":
        row, carried = int(extra_load(spec, robots).argmax()), EVER_S
    elif effect == "tool":
        row = int(throws(spec, robots).tool.argmax())
    else:
        speed = throws(spec, robots).speed
        fastest = np.argsort(-speed.max(axis=(0, 2)))[: (spec.n + 1) // 2]
        thrown = speed[:, fastest[seed % len(fastest)]]
        row, link = (int(place) for place in np.unravel_index(thrown.argmax(), thrown.shape))
    return Choice(disturbed(robots.rows(np.full(WIDTH, row)), NEVER_S, carried), link)


def gains_of(weights: Weights, spec: RobotSpec, mode: ControlMode) -> TrainedGains | None:
    """Return the drive gains of an adversary's weights; None: it has none, or contracts have no choice in this mode."""
    if "stiffness" not in weights or mode is ControlMode.TORQUE:
        return None
    low, high = stiffness_bounds(spec, mode)
    if (low >= STIFFEST * high).any():
        return None
    kp = low * (STIFFEST * high / low) ** np.array(weights["stiffness"])
    least, most = damping_bounds(spec, mode, kp)
    kd = np.clip(least + np.array(weights["damping_of_drive"]) * (most - least), least, most)
    return TrainedGains(tuple(kp.tolist()), tuple(kd.tolist()))


class PushedArm:
    """Shard of copies of one arm, which has used up its lives.

    Attributes:
        shard: before its first tick.
    """

    def __init__(self, job: ShardJob, spec: RobotSpec, effect: Effect) -> None:
        """Build the shard of a job."""
        choice = choose_arm(spec, effect, job.seed)
        self.shard = Shard(job, draw=choice.robots)
        wear = self.shard.robot.plant.wear
        wear.life[:] = LIVES
        wear.apply()
        self._spec = spec
        self._pushes = cast(Pushes, self.shard.robot.plant.disturbances[Pushes.name])
        self._phases, self._directions = self._pushes_on(choice.link)

    def _pushes_on(self, link: int) -> tuple[list[Ints], list[Floats]]:
        """Return the phases in which each robot's link is pushed, (P,), and their directions (P, 3)."""
        first, phases, directions = self._pushes.phase.copy(), list[Ints](), list[Floats]()
        for robot in range(WIDTH):
            found: list[tuple[int, Floats]] = []
            for phase in range(1, 2 * PHASES, 2):
                self._pushes.phase[robot] = phase
                pushed, direction = self._pushes.drawn(robot)
                if pushed == link:
                    found.append((phase, direction))
            phases.append(np.array([phase for phase, _ in found]))
            directions.append(np.array([direction for _, direction in found]))
        self._pushes.phase[:] = first
        return phases, directions

    def push(self, rows: Sequence[Weights]) -> None:
        """Schedule the push of each robot's weights, before the first tick."""
        for robot, row in enumerate(rows):
            nearest = int((self._directions[robot] @ np.array(row["force_toward"])).argmax())
            self._pushes.phase[robot] = self._phases[robot][nearest] - 1
            self._pushes.until[robot] = round(row["force_s"][0] / self._spec.dt)
        self._pushes.apply_all()

    def stiffen(self, gains: Sequence[TrainedGains | None]) -> None:
        """Give the drives of each robot the gains of its own contract; None: the shard's contract has those of all."""
        drives = self.shard.runtime.drives
        for robot, each in enumerate(gains):
            if each:
                for drive in (drives.policy, drives.stop):
                    drive.kp[robot], drive.kd[robot] = each
