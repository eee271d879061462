"""Pushed arm: of many arms the one that a push affects most, in copies with a push and drive gains of their own.

A push of draws.toml has a random moment and direction. Here a candidate chooses both: which push a robot gets is a
function of the number of its phase, and of many phases the one with the most similar direction is taken. A candidate
chooses when packets are late or lost, too: of many streams the one with the oldest reading at that moment is taken.
"""

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from deploy.backends.sim.disturbances import Pushes
from deploy.policy.gain_bounds import damping_bounds, stiffness_bounds
from eval.attack.adversaries import Effect
from eval.attack.loaded_robots import EVER_S, LIVES, MOMENT_S, disturbed, extra_load, heat, sag
from eval.attack.lost_packets import LostPackets
from eval.attack.throws import throws
from eval.attack.trained_gains import STIFFEST, TrainedGains
from eval.attack.weights import Weights
from eval.shard.job import ARM_S, WIDTH, ShardJob
from eval.shard.shard import Shard
from robots.arrays import Floats, Ints
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from robots.spec import RobotSpec

ARMS = 8000
"""Arms of which one is chosen."""
ALIKE = 8
"""Arms with the most effect, which have nearly the same: of them one may be chosen by what else it has."""
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
    """Return the arm of `ARMS` on which a push has the most effect: of throws without its payload, else with it.

    With half of the seeds it is, of the `ALIKE` arms with the most, the one that loses most packets in a row. Throws
    are those of one joint, by the seed: of the half of all joints that a push may throw fastest.
    """
    robots = draw(load_distributions(spec), spec, [robot_seed(seed, robot) for robot in range(ARMS)])
    links, carried = np.full(ARMS, spec.n - 1), MOMENT_S
    if effect in ("load", "sag"):
        size, carried = {"load": extra_load, "sag": sag}[effect](spec, robots), EVER_S
    elif effect == "tool":
        size = throws(spec, robots).tool
    else:
        speed = throws(spec, robots).speed
        fastest = np.argsort(-speed.max(axis=(0, 2)))[: (spec.n + 1) // 2]
        thrown = speed[:, fastest[seed % len(fastest)]]
        size, links = thrown.max(axis=1), thrown.argmax(axis=1)
    most = np.argsort(-size, kind="stable")[:ALIKE]
    lossy = np.random.default_rng(seed).random() < 0.5
    row = int(most[_losses(spec, robots)[most].argmax()] if lossy else most[0])
    return Choice(disturbed(robots.rows(np.full(WIDTH, row)), NEVER_S, carried), int(links[row]))


def _losses(spec: RobotSpec, robots: Draw) -> Floats:
    """Return (B,) loss times mean length of a burst, of the encoder: for comparing robots with each other."""
    encoder = list(spec.sensors).index("encoder")
    return np.asarray(robots["sensors.loss"][:, encoder] * robots["sensors.burst"][:, encoder])


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
    """Shard of copies of one arm, which has used up its lives; one that sags has hot motors, too.

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
        heat(self.shard, np.full(WIDTH, effect == "sag"))
        self._spec = spec
        self._pushes = cast(Pushes, self.shard.robot.plant.disturbances[Pushes.name])
        self._phases, self._directions = self._pushes_on(choice.link)
        self._packets = LostPackets(spec, choice.robots, job.seed, job.ticks)

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
        """Schedule the push and the lost packets of each robot's weights, before the first tick."""
        sensors = self.shard.robot.sensors
        keys = sensors.packet_keys.copy()
        for robot, row in enumerate(rows):
            nearest = int((self._directions[robot] @ np.array(row["force_toward"])).argmax())
            self._pushes.phase[robot] = self._phases[robot][nearest] - 1
            self._pushes.until[robot] = self._tick(row, "force_s")
            keys[robot] = self._packets.oldest_at(self._tick(row, "lost_s"))
        self._pushes.apply_all()
        sensors.use_packets(keys)

    def _tick(self, row: Weights, name: str) -> int:
        """Return the tick of a moment, which its weight has in s after the policy's step without a number."""
        return round((ARM_S + row["refused_s"][0] + row[name][0]) / self._spec.dt)

    def stiffen(self, gains: Sequence[TrainedGains | None]) -> None:
        """Give the drives of each robot the gains of its own contract; None: the shard's contract has those of all."""
        drives = self.shard.runtime.drives
        for robot, each in enumerate(gains):
            if each:
                for drive in (drives.policy, drives.stop):
                    drive.kp[robot], drive.kd[robot] = each
