"""Short simulated run of the shipped runtime with a policy, on robots with the middle values of draws.toml.

Actions can be delayed. A delay of sensor packets is known from their time stamps and compensated by the estimator; a
delay of actions is not modelled and shows whether the policy tolerates it.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from deploy.operation.stop_explanation import StopDetector, explain_reasons
from deploy.policy.policy import Policy
from deploy.simulation import simulate
from deploy.tasks.task import find_task
from eval.judge.counts import Counts
from eval.judge.judge import Judge
from eval.shard.job import ARM_S
from eval.shard.judging import judge_tick
from policies.doctor.simulation.heat_extrapolation import HeatLoad, HeatRecorder
from robots.arrays import Bools, Float32s, Floats, Ints
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.errors import ConfigError
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec

ROBOTS, SECONDS, SEED = 8, 12.2, 0
COMMAND_S = 10.0
"""s, longest velocity command of a walking robot, so that a run contains its end."""
GOALS_SHARE_MIN = 0.5
"""Share of goals that a working policy reaches."""
Delay = tuple[float, float]
ON_TIME, HALF_PERIOD_LATE, PERIOD_LATE, JITTERED = (0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (0.0, 1.0)
"""Smallest and largest delay of an action, in policy periods; rounded to ticks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedRun:
    """Result for B robots of the same draw with different noise and goals.

    Attributes:
        counts: of the judge.
        observation: (K, N) and action: (K, A), raw, at each policy step of each running robot.
        speeds: (S, B, n) rad/s in all ticks since arming: sent, or estimated for compliant drives.
        first_step: (B, n) rad, first target minus position.
        heat_load: of the motors.
        stops: number of stops by reason in words.
    """

    counts: Counts
    observation: Float32s
    action: Float32s
    speeds: Floats
    first_step: Floats
    heat_load: HeatLoad
    stops: Counter[str]

    @property
    def works(self) -> bool:
        """True if there were goals and at least `GOALS_SHARE_MIN` were reached."""
        reached, attempted = self.counts.reached.sum(), self.counts.attempted.sum()
        return bool(attempted > 0 and reached >= GOALS_SHARE_MIN * attempted)


def run_simulation(
    spec: RobotSpec,
    policy: Policy,
    delay: Delay,
    rows: Sequence[int] = range(ROBOTS),
    seconds: float = SECONDS,
) -> SimulatedRun:
    """Simulate robots under a policy that fits them.

    Args:
        delay: smallest and largest random delay of an action, in policy periods.
        rows: for each robot the index of its noise and goals. seconds: simulated time.

    Raises:
        FirstshiftError: the robot's files are incomplete for a simulation or its judge.
    """
    spec = find_task(policy.contract.task, "contract: task").limit_goal_period(spec, COMMAND_S)
    simulation = _Simulation(spec, policy, delay, [robot_seed(SEED, row) for row in rows])
    for tick in range(round(seconds / spec.dt)):
        simulation.tick(tick)
    return simulation.result()


class _Simulation:
    """Running simulation and its records."""

    def __init__(
        self, spec: RobotSpec, policy: Policy, delay: Delay, seeds: Sequence[np.random.SeedSequence]
    ) -> None:
        robots, contract = len(seeds), policy.contract
        draw = median_draw(load_distributions(spec), spec, robots)
        self._runtime, self._robot = simulate(spec, contract, seeds, policy, draw=draw)
        criterion, observed = self._runtime.task.criterion, contract.observed
        mode = contract.action.control_mode
        self._judge = Judge(spec, torque_max(spec), robots, criterion=criterion, mode=mode, observed=observed)
        self._policy, self._rng = policy, np.random.default_rng(SEED)
        self._delay_min, self._delay_max = (int(share * self._runtime.decimation) for share in delay)
        self._pending_actions: dict[int, Float32s] = {}
        self._steps: list[tuple[Float32s, Float32s]] = []
        self._speeds: list[Floats] = []
        self._first_step = np.full((robots, spec.n), np.nan)
        self._arm, self._heat_recorder = round(ARM_S / spec.dt), HeatRecorder(self._robot)
        self._leaving, self._stops = StopDetector(), Counter[str]()

    def tick(self, tick: int) -> None:
        """Advance one tick, with the action that is due, if any."""
        runtime = self._runtime
        if tick == self._arm:
            refused = runtime.arm(np.ones(len(self._first_step), dtype=bool))
            self._count_stops(np.flatnonzero(refused), refused)
        observation = runtime.sense()
        if observation is not None:
            self._run_policy(tick, observation)
        action, running = self._pending_actions.pop(tick, None), runtime.supervisor.running
        runtime.act(action)
        self._count_stops(self._leaving.step(runtime), runtime.supervisor.reason)
        truth = self._robot.truth()
        judge_tick(self._judge, truth, runtime, action)
        self._heat_recorder.record(truth)
        self._record(tick, running if action is not None else None)

    def _count_stops(self, robots: Iterable[int], reason: Ints) -> None:
        self._stops.update(explain_reasons(self._runtime, int(reason[robot]), int(robot)) for robot in robots)

    def _record(self, tick: int, running: Bools | None) -> None:
        """Record speeds, and the first target of robots that just started `running`; None without an action."""
        runtime = self._runtime
        if tick >= self._arm:
            # Compliant drives do not follow the setpoint closely: use the estimated joint speed.
            self._speeds.append((runtime.setpoint if runtime.springs is None else runtime.state).qd.copy())
        if running is not None:
            starts = running & np.isnan(self._first_step[:, 0])
            self._first_step[starts] = (runtime.target.value - runtime.state.q)[starts]

    def _run_policy(self, tick: int, observation: Float32s) -> None:
        action = self._policy.step(observation).copy()
        due = tick + int(self._rng.integers(self._delay_min, self._delay_max + 1))
        while due in self._pending_actions:
            due += 1
        self._pending_actions[due] = action
        running = self._runtime.supervisor.running
        self._steps.append((observation[running], action[running]))

    def result(self) -> SimulatedRun:
        """Return the result; ConfigError if a robot did not arm, or an observation was not finite."""
        if np.isnan(self._first_step).any():
            raise ConfigError(f"a robot did not start: {'; '.join(self._stops) or 'no reason'}")
        observation, action = (np.concatenate(rows) for rows in zip(*self._steps, strict=True))
        if not np.isfinite(observation).all():
            raise ConfigError("an observation was not finite: compare the scales of its terms")
        return SimulatedRun(
            counts=self._judge.counts(),
            observation=observation,
            action=action,
            speeds=np.array(self._speeds),
            first_step=self._first_step,
            heat_load=self._heat_recorder.heat_load(),
            stops=self._stops,
        )
