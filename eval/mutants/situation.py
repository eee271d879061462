"""Mutant: a removed guard, a situation in which it matters, and the monitor that must report it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Fault
from deploy.policy.contract import Contract, Observed
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import Term
from deploy.reasons import Reason
from deploy.runtime import Runtime
from deploy.simulation import simulate
from deploy.sources.catalogue import SOURCES
from eval.faults.hostile_policy import HostilePolicy
from eval.judge.counts import Counts
from eval.mutants.guard_removal import GuardRemoval, ignore_reasons, in_sequence
from eval.shard.job import ARM_S
from eval.shard.judging import judge_tick, make_judge
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

LATCHES, INVALID = "latches", "invalid"
"""Counts of the judge besides its monitors."""

ActionMode = Literal["position_increment", "velocity", "torque"]
Disturbance = Callable[[Runtime, SimRobot, float], None]
SensorFaults = Callable[[RobotSpec], tuple[Fault, ...]]

keep_guards: GuardRemoval = in_sequence()
no_disturbance: Disturbance = in_sequence()


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
            within physical limits. faults: of sensors, as a function of the spec.
        scale, leash: rad, of the contract's action where it moves angles.
        mode: of the contract's action; a full action is all speed or all torque of a joint, or `scale`.
        arm_at_once: arm after one tick instead of `ARM_S`.
    """

    description: str
    policy: HostilePolicy
    seconds: float = 2.5
    disturbance: Disturbance = no_disturbance
    prepare: GuardRemoval = keep_guards
    draws: Mapping[str, float] = field(default_factory=dict)
    spread: float = 1.0
    faults: SensorFaults = lambda spec: ()
    scale: float = SCALE
    leash: float = LEASH
    mode: ActionMode = "position_increment"
    arm_at_once: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A removed guard and the event that must follow.

    Attributes:
        guard: description of the guard and its removal.
        remove_guard: function that removes it from a runtime.
        situation: run with the guard and without.
        monitor: name of the judge's monitor: no events with the guard, at least one without.
        reasons: stop reasons that are no longer raised.
    """

    guard: str
    remove_guard: GuardRemoval
    situation: Situation
    monitor: str
    reasons: Reason = Reason.NONE


def check_off(guard: str, reason: Reason, monitor: str, situation: Situation) -> Mutant:
    """Return the mutant without one check: its stop reason is never raised."""
    remove_guard = ignore_reasons(reason)
    return Mutant(
        guard=f"{guard}, off", remove_guard=remove_guard, situation=situation, monitor=monitor, reasons=reason
    )


def run_situation(spec: RobotSpec, situation: Situation, remove_guard: GuardRemoval = keep_guards) -> Counts:
    """Simulate a situation with a guard removed; return the judge's counts."""
    seeds = [robot_seed(SEED, robot) for robot in range(ROBOTS)]
    robots, faults = _draw(spec, seeds, situation), situation.faults(spec)
    runtime, robot = simulate(spec, contract(spec, situation), seeds, draw=robots, faults=faults)
    judge = make_judge(spec, runtime.contract, ROBOTS)
    situation.prepare(runtime)
    remove_guard(runtime)
    armed = 1 if situation.arm_at_once else round(ARM_S / spec.dt)
    for tick in range(round(situation.seconds / spec.dt)):
        if tick == armed:
            runtime.arm(np.ones(ROBOTS, dtype=bool))
        situation.disturbance(runtime, robot, tick * spec.dt)
        action = None if runtime.sense() is None else situation.policy(runtime)
        runtime.act(action)
        judge_tick(judge, robot.truth(), runtime, action)
    return judge.counts()


def _draw(spec: RobotSpec, seeds: Sequence[np.random.SeedSequence], situation: Situation) -> Draw:
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
        action=_action(spec, situation),
        trained={"recipe": "by hand, to do harm"},
        observed=Observed(mean=home + (0.0,) * spec.n, deviation=(TRAINING_DEVIATION,) * 2 * spec.n),
    )


def _action(spec: RobotSpec, situation: Situation) -> ActionSpec:
    mode = situation.mode
    if mode == "position_increment":
        scale, leash = np.full(spec.n, situation.scale), situation.leash
    else:
        scale, leash = spec.joint_array("qd_max") if mode == "velocity" else torque_max(spec), None
    return ActionSpec(mode=mode, size=spec.n, scale=tuple(scale.tolist()), clip=(-1.0, 1.0), leash_rad=leash)


def _term(spec: RobotSpec, source: str) -> Term:
    frame, unit = SOURCES[source].frame, SOURCES[source].unit
    return Term.model_validate(
        {"name": source, "source": source, "frame": frame, "unit": unit, "size": spec.n}
        | {"scale": (1.0,) * spec.n}
    )
