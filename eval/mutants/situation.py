"""Situations in which a guard matters: what the policy wants, and what befalls robot and stack."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from deploy.backends.sim.backend import simulate
from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Fault
from deploy.policy.contract import ActionSpec, Contract, Observed
from deploy.policy.observation_source import SOURCES
from deploy.policy.observation_terms import Term
from deploy.runtime import Runtime
from eval.judge.counts import Counts
from eval.judge.judge import Judge
from eval.soak.shard import ARM_S, judge_tick
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED, ROBOTS = 17, 8
SCALE, LEASH = 0.5, 1.5
"""rad: a policy that may ask for ten times what the shipped one may."""
SAW = 0.5
"""rad around home and rad/s, standard deviations of what its training saw: about what the shipped one's did."""

HostilePolicy = Callable[[Runtime], Floats]
Disturbance = Callable[[Runtime, SimRobot, float], None]


def _nothing(runtime: Runtime, robot: SimRobot, t: float) -> None:
    """Befall nobody."""


def nobody(runtime: Runtime) -> None:
    """Leave all as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """Some seconds that a stack must survive, the same for a whole one and for its mutants.

    Attributes:
        words: what it is, for the table.
        says: the policy: the action (B, A) that it wants, before clip and scale.
        seconds: s lived, of which the first `ARM_S` disarmed.
        befalls: called before each tick with s since the start: what happens to the robots.
        prepare: what is broken in the stack beforehand: a guard that stands behind another one is only asked where
            the one before it has failed.
        draws: numbers of the draw that are not left to chance. spread: how many times as far from the middle of its
            span as drawn every other one is, within what physics allows. faults: of sensors.
        scale, leash: rad, of the contract's action.
        arm_s: s, when the operator arms.
    """

    words: str
    says: HostilePolicy
    seconds: float = 2.5
    befalls: Disturbance = _nothing
    prepare: Callable[[Runtime], None] = nobody
    draws: Mapping[str, float] = field(default_factory=dict)
    spread: float = 1.0
    faults: tuple[Fault, ...] = ()
    scale: float = SCALE
    leash: float = LEASH
    arm_s: float = ARM_S


def live(spec: RobotSpec, situation: Situation, weaken: Callable[[Runtime], None] = nobody) -> Counts:
    """What the judge finds in a situation, with a guard of the runtime weakened."""
    seeds = [robot_seed(SEED, robot) for robot in range(ROBOTS)]
    given, promise = _drawn(spec, seeds, situation), contract(spec, situation)
    runtime, robot = simulate(spec, promise, seeds, given=given, faults=situation.faults)
    observed, scoring = runtime.contract.observed, runtime.task.rule
    judge = Judge(spec, torque_max(spec), ROBOTS, observed=observed, scoring=scoring)
    situation.prepare(runtime)
    weaken(runtime)
    for tick in range(round(situation.seconds / spec.dt)):
        if tick == round(situation.arm_s / spec.dt):
            runtime.arm(np.ones(ROBOTS, dtype=bool))
        situation.befalls(runtime, robot, tick * spec.dt)
        said = None if runtime.sense() is None else situation.says(runtime)
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
    """What a hostile policy promises: it looks at nothing but angles and speeds."""
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
        observed=Observed(mean=home + (0.0,) * spec.n, deviation=(SAW,) * 2 * spec.n),
    )


def _term(spec: RobotSpec, source: str) -> Term:
    frame, unit = SOURCES[source].frame, SOURCES[source].unit
    return Term.model_validate(
        {"name": source, "source": source, "frame": frame, "unit": unit, "size": spec.n}
        | {"scale": (1.0,) * spec.n}
    )
