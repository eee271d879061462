"""Situations in which a guard matters: policy, disturbance and draw, and their simulation under the judge."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from deploy.backends.sim.backend import simulate
from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Fault
from deploy.policy.contract import ActionSpec, Contract, Observed
from deploy.policy.contract_term import Term
from deploy.policy.observation_sources import SOURCES
from deploy.runtime import Runtime
from eval.judge.counts import Counts
from eval.judge.judge import Judge
from eval.shard.job import ARM_S
from eval.shard.judging import judge_tick
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED, ROBOTS = 17, 8
SCALE, LEASH = 0.5, 1.5
"""rad: action scale and leash of the hostile policy, ten times those of the shipped one."""
TRAINING_DEVIATION = 0.5
"""rad and rad/s, standard deviations of training observations, similar to those of the shipped policy."""

HostilePolicy = Callable[[Runtime], Floats]
Disturbance = Callable[[Runtime, SimRobot, float], None]


def _nothing(runtime: Runtime, robot: SimRobot, t: float) -> None:
    """Do nothing."""


def keep_guards(runtime: Runtime) -> None:
    """Remove nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """A short simulation, the same with all guards and for each mutant.

    Attributes:
        description: for the table.
        policy: function returning actions (B, A) before clip and scale.
        seconds: s, duration, of which the first `ARM_S` disarmed.
        disturbance: called before each tick with the time in s.
        prepare: removes guards that would act before the tested one.
        draws: fixed numbers of the draw. spread: factor on the distance of all others from the middle of their span,
            within physical limits. faults: of sensors.
        scale, leash: rad, of the contract's action.
        arm_s: s, time of arming.
    """

    description: str
    policy: HostilePolicy
    seconds: float = 2.5
    disturbance: Disturbance = _nothing
    prepare: Callable[[Runtime], None] = keep_guards
    draws: Mapping[str, float] = field(default_factory=dict)
    spread: float = 1.0
    faults: tuple[Fault, ...] = ()
    scale: float = SCALE
    leash: float = LEASH
    arm_s: float = ARM_S


def run_situation(
    spec: RobotSpec, situation: Situation, remove_guard: Callable[[Runtime], None] = keep_guards
) -> Counts:
    """Simulate a situation with a guard removed; return the judge's counts."""
    seeds = [robot_seed(SEED, robot) for robot in range(ROBOTS)]
    given, promise = _drawn(spec, seeds, situation), contract(spec, situation)
    runtime, robot = simulate(spec, promise, seeds, given=given, faults=situation.faults)
    observed, scoring = runtime.contract.observed, runtime.task.rule
    judge = Judge(spec, torque_max(spec), ROBOTS, observed=observed, scoring=scoring)
    situation.prepare(runtime)
    remove_guard(runtime)
    for tick in range(round(situation.seconds / spec.dt)):
        if tick == round(situation.arm_s / spec.dt):
            runtime.arm(np.ones(ROBOTS, dtype=bool))
        situation.disturbance(runtime, robot, tick * spec.dt)
        said = None if runtime.sense() is None else situation.policy(runtime)
        runtime.act(said)
        judge_tick(judge, robot.truth(), runtime, said)
    return judge.counts()


def _drawn(spec: RobotSpec, seeds: Sequence[np.random.SeedSequence], situation: Situation) -> Draw:
    distributions = load_distributions(spec)
    usual, out = draw(distributions, spec, seeds), dict(situation.draws)
    if situation.spread == 1.0:
        return usual.replaced(out)
    spread: dict[str, Floats] = {}
    for name, quantity, span in distributions.spans():
        middle = (span.low + span.high) / 2
        far = middle + situation.spread * (usual[name] - middle)
        spread[name] = np.clip(far, quantity.low, quantity.high)
    return usual.replaced(spread).replaced(out)


def contract(spec: RobotSpec, situation: Situation) -> Contract:
    """Return the contract of a hostile policy, which observes only joint positions and velocities."""
    home = tuple(spec.joint_array("q_home").tolist())
    return Contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        policy_hz=50,
        control_hz=spec.rates.control_hz,
        task="reach",
        observation=(_term(spec, "joint_position"), _term(spec, "joint_velocity")),
        action=ActionSpec(
            mode="position_increment",
            size=spec.n,
            scale=(situation.scale,) * spec.n,
            clip=(-1.0, 1.0),
            leash_rad=situation.leash,
        ),
        trained={"recipe": "by hand, to do harm"},
        observed=Observed(mean=home + (0.0,) * spec.n, deviation=(TRAINING_DEVIATION,) * 2 * spec.n),
    )


def _term(spec: RobotSpec, source: str) -> Term:
    frame, unit = SOURCES[source].frame, SOURCES[source].unit
    return Term.model_validate(
        {"name": source, "source": source, "frame": frame, "unit": unit, "size": spec.n}
        | {"scale": (1.0,) * spec.n}
    )
