"""How guards are taken away from a runtime that was built whole: no source text is edited."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from deploy.estimation.estimator import Estimator
from deploy.motion.smoother import Smoother
from deploy.runtime import Runtime
from deploy.state import Reason, Setpoint, State, Verdict
from robots.arrays import Bools, Floats

Weaken = Callable[[Runtime], None]


def wrap_method(owner: object, name: str, call: Callable[..., Any]) -> None:
    """Let `call` answer in the place of a method: it is given the method, then what the method is called with."""
    setattr(owner, name, partial(call, getattr(owner, name)))


def remove_all(*weakens: Weaken) -> Weaken:
    """One after the other."""

    def weaken(runtime: Runtime) -> None:
        for each in weakens:
            each(runtime)

    return weaken


def ignore_reasons(reasons: Reason) -> Weaken:
    """Neither safety nor the estimator ever has these reasons."""
    seen = ~np.int64(reasons)

    def judge(step: Callable[..., Verdict], *asked: Any) -> Verdict:
        verdict = step(*asked)
        return verdict._replace(reason=verdict.reason & seen)

    def believe(step: Callable[..., State], *heard: Any) -> State:
        state = step(*heard)
        return state._replace(fault=state.fault & seen)

    def weaken(runtime: Runtime) -> None:
        wrap_method(runtime.safety, "step", judge)
        wrap_method(runtime.estimator, "step", believe)

    return weaken


def skip_stop_checks(*, ahead: bool = True, mid_stop: bool = True, rest: bool = True) -> Weaken:
    """Safety is shown the setpoint itself in the place of these parts of the stop that would begin there."""

    def judge(
        step: Callable[..., Verdict], state: State, sent: Setpoint, now: Setpoint, *stop: Any
    ) -> Verdict:
        first, q_mid_stop, q_rest = stop
        return step(
            state,
            sent,
            now,
            first if ahead else now,
            q_mid_stop if mid_stop else now.q,
            q_rest if rest else now.q,
        )

    return lambda runtime: wrap_method(runtime.safety, "step", judge)


def ignore_speed_overshoot(runtime: Runtime) -> None:
    """The speed that a stop would still gain, until its acceleration has run out, is none."""
    runtime.safety.twice_jerk = np.full(runtime.spec.n, np.inf)


def scale_planner_limits(**factors: float) -> Weaken:
    """The planner keeps to limits that are so many times those of robot.toml."""

    def weaken(runtime: Runtime) -> None:
        spec = runtime.spec
        joints = tuple(
            joint.model_copy(update={name: factor * getattr(joint, name) for name, factor in factors.items()})
            for joint in spec.joints
        )
        runtime.smoother = Smoother(spec.model_copy(update={"joints": joints}), runtime.robot.robots)

    return weaken


def scale_limits_while_following(**factors: float) -> Weaken:
    """As `planner`, where a target is followed; stops keep to the limits."""

    def plan(right: Callable[..., Setpoint], runtime: Runtime, wild: Smoother, *asked: Any) -> Setpoint:
        wild.commit(runtime.smoother.sent)
        stopping = asked[1][:, None]
        pairs = zip(right(*asked), wild.next(*asked), strict=True)
        return Setpoint(*(np.where(stopping, *pair) for pair in pairs))

    def weaken(runtime: Runtime) -> None:
        right = runtime.smoother
        scale_planner_limits(**factors)(runtime)
        wild, runtime.smoother = runtime.smoother, right
        wrap_method(right, "next", lambda step, *asked: plan(step, runtime, wild, *asked))

    return weaken


def widen_target_range(runtime: Runtime) -> None:
    """Targets may lie a radian beyond the working range."""
    runtime.smoother.q_min -= 1.0
    runtime.smoother.q_max += 1.0


def plan_nan_at(t: float, *, angles: bool) -> Weaken:
    """At one tick the planner's next setpoint is no number: in its speeds, or in its angles too."""

    def plan(step: Callable[..., Setpoint], runtime: Runtime, *asked: Any) -> Setpoint:
        setpoint = step(*asked)
        if round((runtime.t - t) / runtime.spec.dt) == 0:
            for part in setpoint[0 if angles else 1 :]:
                part[:] = np.nan
        return setpoint

    def weaken(runtime: Runtime) -> None:
        wrap_method(runtime.smoother, "next", lambda step, *asked: plan(step, runtime, *asked))

    return weaken


def send_non_finite(runtime: Runtime) -> None:
    """The runtime sends what it is given, number or not."""
    wrap_method(runtime, "replace_non_finite", lambda _, planned: planned)
    wrap_method(runtime, "obeyed_or_stop", lambda _, obey, planned: (planned, runtime.verdict.tau))


def stop_instantly(runtime: Runtime) -> None:
    """What is refused is answered by standing still at once, not by the stop that was prepared."""

    def instead(ask: Callable[..., tuple[Setpoint, Floats]], obey: Bools, planned: Setpoint) -> object:
        setpoint, tau = ask(obey, planned)
        stands = [runtime.smoother.q, np.zeros_like(setpoint.qd), np.zeros_like(setpoint.qdd)]
        parts = [np.where(obey[:, None], *pair) for pair in zip(setpoint, stands, strict=True)]
        return Setpoint(*parts), tau

    wrap_method(runtime, "obeyed_or_stop", instead)


def ignore_non_finite_action(runtime: Runtime) -> None:
    """The runtime does not mind an action that is no number; `Action` still leaves it out."""
    wrap_method(
        runtime,
        "stop_reasons",
        lambda _: runtime.verdict.reason | runtime.state.fault | runtime.requested_stop,
    )


def follow_non_finite_action(runtime: Runtime) -> None:
    """An action that is no number moves the target all the same."""

    def step(_: object, action: Floats, q_setpoint: Floats) -> object:
        stage = runtime.action
        stage.q += stage.scale * action
        return stage.target

    wrap_method(runtime.action, "step", step)


def remove_action_clip(runtime: Runtime) -> None:
    """An action may be as large as it likes."""
    runtime.action.low, runtime.action.high = -np.inf, np.inf


def remove_leash(runtime: Runtime) -> None:
    """The target may run away from the setpoint."""
    runtime.action.leash = np.inf


def downgrade_to_category_2(reasons: Reason) -> Weaken:
    """The supervisor takes these reasons for category 2: the power stays, and the robot goes on by itself."""

    def step(advance: Callable[..., Bools], runtime: Runtime, *asked: Any) -> Bools:
        runtime.supervisor.reason &= ~np.int64(reasons)
        return advance(*asked)

    def weaken(runtime: Runtime) -> None:
        wrap_method(runtime.supervisor, "step", lambda advance, *asked: step(advance, runtime, *asked))

    return weaken


class NeverMovingEstimator(Estimator):
    """It never says that a joint moves."""

    @property
    def moving(self) -> Bools:
        """Nothing ever does."""
        return np.zeros_like(self.joints.e, dtype=bool)


def arm_while_moving(runtime: Runtime) -> None:
    """Robots are armed whether or not a joint moves."""
    runtime.estimator = NeverMovingEstimator(runtime.spec, runtime.robot.robots)


def open_innovation_gate(runtime: Runtime) -> None:
    """No sample is left out."""
    runtime.estimator.joints.gate = np.inf


def trust_first_sample(runtime: Runtime) -> None:
    """A filter is believed from its first sample on."""

    def now(step: Callable[..., State], t: float, *heard: Any) -> State:
        return step(t, *heard)._replace(age=(t - runtime.estimator.joints.t_sample).max(axis=1))

    wrap_method(runtime.estimator, "step", now)


def remove_heat_margin(runtime: Runtime) -> None:
    """A winding is as warm as it is believed to be, and no warmer."""
    runtime.estimator.windings.margin_k = runtime.estimator.windings.margin_share = 0.0


def remove_foldback(runtime: Runtime) -> None:
    """Hot motors go on as cold ones do, up to the stop."""
    foldback = runtime.estimator.windings.foldback

    def step(fold_back: Callable[..., None], *heat: Any) -> None:
        fold_back(*heat)
        foldback.current_share[:] = 1.0
        foldback.speed_share[:] = 1.0

    wrap_method(foldback, "step", step)


def freeze_lost_currents(runtime: Runtime) -> None:
    """What is not heard any more stays as it was last heard."""
    wrap_method(runtime.estimator.windings, "check_sensors", lambda *_: None)


def accept_stuck_currents(runtime: Runtime) -> None:
    """A current may repeat itself for ever."""
    runtime.estimator.windings.stuck_repeats = np.inf
