"""A short life in simulation: the shipped runtime on a robot as draws.toml has it in the middle.

A packet that is late says when it was taken, and the estimator makes up for it: that delay is modelled. What shakes a
robot is a delay that nobody knows of, so it is the actions that come late here.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deploy.backends.sim.backend import simulate
from deploy.policy.policy import Policy
from deploy.safety.diagnostics import StopDetector, explain_reasons
from deploy.tasks.task import find_task
from eval.judge.counts import Counts
from eval.judge.judge import Judge
from eval.soak.shard import ARM_S, judge_tick
from policies.doctor.simulation.heat_extrapolation import Thermometer, Warmth
from robots.arrays import Bools, Float32s, Floats, Ints
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.errors import ConfigError
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec

ROBOTS, SECONDS, SEED = 8, 12.2, 0
COMMAND_S = 10.0
"""s, how long a robot that walks is told the same at most: a trial sees the end of it."""
HALF_OF = 0.5
"""Goals of a policy that works at all."""
PUNCTUAL, HALF, LATE, JITTERING = (0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (0.0, 1.0)
"""Least and most lateness of an action, in periods of the policy; it comes at whole ticks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """What B robots of the same draw did, each with noise and goals of its own.

    Attributes:
        counts: what the judge saw.
        observation: (K, N) and action: (K, A), raw, at each step of the policy of each robot under way.
        speeds: (S, B, n) rad/s, sent; of soft drives, believed; of all ticks since arming.
        first: (B, n) rad, the first target less where the robot was.
        warmth: of the motors.
        stops: how often a robot stopped, by reason in words.
    """

    counts: Counts
    observation: Float32s
    action: Float32s
    speeds: Floats
    first: Floats
    warmth: Warmth
    stops: Counter[str]

    @property
    def works(self) -> bool:
        """Whether most goals were reached, of which there were some."""
        reached, attempted = self.counts.reached.sum(), self.counts.attempted.sum()
        return bool(attempted > 0 and reached >= HALF_OF * attempted)


def live(
    spec: RobotSpec,
    policy: Policy,
    lateness: tuple[float, float],
    rows: Sequence[int] = range(ROBOTS),
    seconds: float = SECONDS,
) -> Life:
    """Let robots work for a while.

    Args:
        spec: the robot. policy: one that fits it.
        lateness: of each action, drawn between least and most, in periods of the policy.
        rows: of each robot, whose noise and goals it has. seconds: how long.

    Raises:
        FirstshiftError: the robot's files do not suffice for a simulation or its judge.
    """
    spec = find_task(policy.contract.task, "contract: task").shorten_period(spec, COMMAND_S)
    trial = _Trial(spec, policy, lateness, [robot_seed(SEED, row) for row in rows])
    for tick in range(round(seconds / spec.dt)):
        trial.tick(tick)
    return trial.life()


class _Trial:
    """The robots, and what is noted of them."""

    def __init__(
        self,
        spec: RobotSpec,
        policy: Policy,
        lateness: tuple[float, float],
        seeds: Sequence[np.random.SeedSequence],
    ) -> None:
        robots = len(seeds)
        self._policy, self._everybody = policy, np.ones(robots, dtype=bool)
        contract = policy.contract
        given = median_draw(load_distributions(spec), spec, robots)
        self._runtime, self._robot = simulate(spec, contract, seeds, policy, given=given)
        rule, observed = self._runtime.task.rule, contract.observed
        self._judge = Judge(spec, torque_max(spec), robots, scoring=rule, observed=observed)
        self._rng = np.random.default_rng(SEED)
        self._least, self._most = (int(share * self._runtime.decimation) for share in lateness)
        self._coming: dict[int, Float32s] = {}
        self._arm = round(ARM_S / spec.dt)
        self._steps: list[tuple[Float32s, Float32s]] = []
        self._speeds: list[Floats] = []
        self._first = np.full((robots, spec.n), np.nan)
        self._thermometer = Thermometer(self._robot)
        self._leaving, self._stops = StopDetector(), Counter[str]()

    def tick(self, tick: int) -> None:
        """One tick, in which a late action may come."""
        runtime = self._runtime
        if tick == self._arm:
            refused = runtime.arm(self._everybody)
            self._stops.update(self._why(robot, refused) for robot in np.flatnonzero(refused).tolist())
        observation = runtime.sense()
        if observation is not None:
            self._think(tick, observation)
        said, led = self._coming.pop(tick, None), runtime.supervisor.running
        runtime.act(said)
        leaving = self._leaving.step(runtime)
        self._stops.update(self._why(robot, runtime.supervisor.reason) for robot in leaving)
        truth = self._robot.truth()
        judge_tick(self._judge, truth, runtime, said)
        self._thermometer.look(truth)
        if tick >= self._arm:
            # A soft drive is not where it is sent: there what the joint does counts.
            self._speeds.append((runtime.setpoint if runtime.springs is None else runtime.state).qd.copy())
        if said is not None:
            self._begin(led)

    def _why(self, robot: int, reason: Ints) -> str:
        return explain_reasons(self._runtime, int(reason[robot]), robot)

    def _think(self, tick: int, observation: Float32s) -> None:
        action = self._policy.step(observation).copy()
        due = tick + int(self._rng.integers(self._least, self._most + 1))
        while due in self._coming:
            due += 1
        self._coming[due] = action
        running = self._runtime.supervisor.running
        self._steps.append((observation[running], action[running]))

    def _begin(self, led: Bools) -> None:
        """Note the first target of robots that the policy leads since now."""
        begins = led & np.isnan(self._first[:, 0])
        self._first[begins] = (self._runtime.target.q - self._runtime.state.q)[begins]

    def life(self) -> Life:
        """All of it.

        Raises:
            ConfigError: a robot refused to begin, or what it saw was no number.
        """
        if np.isnan(self._first).any():
            raise ConfigError(f"a robot never came under way: {'; '.join(self._stops) or 'no reason'}")
        observation, action = (np.concatenate(rows) for rows in zip(*self._steps, strict=True))
        if not np.isfinite(observation).all():
            raise ConfigError("an observation was no finite number: compare the scales of its terms")
        return Life(
            counts=self._judge.counts(),
            observation=observation,
            action=action,
            speeds=np.array(self._speeds),
            first=self._first,
            warmth=self._thermometer.warmth(),
            stops=self._stops,
        )
