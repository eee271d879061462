"""Functions that remove guards from a complete runtime by replacing methods and limits."""

from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any, Literal, ParamSpec, get_args

import numpy as np

from deploy.estimation.estimator import Estimator
from deploy.motion.prepared_stop import select
from deploy.motion.smoother import Smoother
from deploy.motion.smoothers import make_smoother
from deploy.reasons import Reason
from deploy.runtime import Runtime
from deploy.safety.check import UNBOUNDED
from deploy.state import STOP_MOMENTS, Setpoint, State, Stop, Verdict
from robots.arrays import Bools, Floats
from robots.margins import ModeMargins
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

GuardRemoval = Callable[[Runtime], None]
StopMoment = Literal["first step", "braking", "rest"]
P = ParamSpec("P")


def wrap_method(owner: object, name: str, call: Callable[..., Any]) -> None:
    """Replace a method by `call`, which gets the original method and then its arguments."""
    setattr(owner, name, partial(call, getattr(owner, name)))


def in_sequence(*calls: Callable[P, None]) -> Callable[P, None]:
    """Return a function that makes several calls, such as guard removals, with the same arguments."""

    def call_all(*args: P.args, **kwargs: P.kwargs) -> None:
        for call in calls:
            call(*args, **kwargs)

    return call_all


def override(stage: str, **values: float) -> GuardRemoval:
    """Return a removal that sets attributes of the stage at a dotted path of the runtime."""

    def remove_guard(runtime: Runtime) -> None:
        for name, value in values.items():
            getattr(owner := attrgetter(stage)(runtime), name)  # a name that does not exist removes nothing
            setattr(owner, name, value)

    return remove_guard


remove_action_clip = override("action", low=-np.inf, high=np.inf)
remove_leash = override("action", leash=np.inf)
remove_heat_margin = override("estimator.windings", margin_k=0.0, margin_share=0.0)
accept_stuck_currents = override("estimator.windings", stuck_repeats=np.inf)


def open_innovation_gate(runtime: Runtime) -> None:
    """Fuse every sample, however far it is from the estimate."""
    joints = runtime.estimator.joints
    joints.rules = joints.rules._replace(gate=np.inf)


def ignore_reasons(reasons: Reason) -> GuardRemoval:
    """Remove these stop reasons from safety and from the estimator."""
    kept = ~np.int64(reasons)

    def masked(field: str) -> Callable[..., Any]:
        def step(original: Callable[..., Any], *arguments: Any) -> Any:
            result = original(*arguments)
            return result._replace(**{field: getattr(result, field) & kept})

        return step

    def remove_guard(runtime: Runtime) -> None:
        wrap_method(runtime.safety, "step", masked("reason"))
        wrap_method(runtime.estimator, "step", masked("fault"))

    return remove_guard


def skip_stop_checks(*moments: StopMoment) -> GuardRemoval:
    """Give safety the setpoint in place of some moments of the prepared stop, or of all."""
    skipped = moments or get_args(StopMoment)

    def step(
        check: Callable[..., Verdict], state: State, sent: Setpoint, now: Setpoint, stop: Stop
    ) -> Verdict:
        at_setpoint: dict[str, dict[str, Any]] = {
            "first step": {"ahead": now},
            "braking": {name: np.array([getattr(now, name)] * STOP_MOMENTS) for name in ("q", "qd", "qdd")},
            "rest": {"q_rest": now.q},
        }
        for moment in skipped:
            stop = stop._replace(**at_setpoint[moment])
        return check(state, sent, now, stop)

    return lambda runtime: wrap_method(runtime.safety, "step", step)


def widen_check(name: str) -> GuardRemoval:
    """Let one of safety's checks accept any finite number."""

    def remove_guard(runtime: Runtime) -> None:
        for table in (runtime.safety._motion, runtime.safety._plan, runtime.safety._estimate):
            columns = np.repeat([check.name == name for check in table.checks], table._widths)
            table._low[columns], table._high[columns] = -UNBOUNDED, UNBOUNDED

    return remove_guard


def ignore_speed_overshoot(runtime: Runtime) -> None:
    """Ignore the further increase of speed while a stop reduces its acceleration to 0."""
    runtime.safety.twice_jerk = np.full(runtime.spec.n, np.inf)


def _scaled_smoother(runtime: Runtime, factors: dict[str, float]) -> Smoother:
    spec = runtime.spec
    joints = tuple(
        joint.model_copy(update={name: factor * getattr(joint, name) for name, factor in factors.items()})
        for joint in spec.joints
    )
    return Smoother(spec.model_copy(update={"joints": joints}), runtime.robot.robots)


def scale_planner_limits(**factors: float) -> GuardRemoval:
    """Scale the planner's limits by factors."""

    def remove_guard(runtime: Runtime) -> None:
        runtime.smoother = _scaled_smoother(runtime, factors)

    return remove_guard


def scale_limits_while_following(**factors: float) -> GuardRemoval:
    """Scale the planner's limits while a target is followed; stops keep the true limits."""

    def remove_guard(runtime: Runtime) -> None:
        scaled = _scaled_smoother(runtime, factors)

        def plan(nominal: Callable[..., Setpoint], q_target: Floats, stopping: Bools) -> Setpoint:
            scaled.commit(runtime.smoother.sent)
            return select(stopping, nominal(q_target, stopping), scaled.next(q_target, stopping))

        wrap_method(runtime.smoother, "next", plan)

    return remove_guard


def widen_target_range(runtime: Runtime) -> None:
    """Widen the range of targets by one radian at each end."""
    runtime.smoother.q_min -= 1.0
    runtime.smoother.q_max += 1.0


def plan_nan_at(t: float, *, angles: bool) -> GuardRemoval:
    """Make the planned setpoint NaN in the tick at `t` s: in its velocities, or in its positions too."""

    def remove_guard(runtime: Runtime) -> None:
        def plan(step: Callable[..., Setpoint], *arguments: Any) -> Setpoint:
            setpoint = step(*arguments)
            if round((runtime.t - t) / runtime.spec.dt) == 0:
                for part in (setpoint.q, setpoint.qd, setpoint.qdd)[0 if angles else 1 :]:
                    part[:] = np.nan
            return setpoint

        wrap_method(runtime.smoother, "next", plan)

    return remove_guard


def send_non_finite(runtime: Runtime) -> None:
    """Send the planned setpoint even if it is not finite."""
    wrap_method(runtime, "cut_power_without_plan", lambda _, planned: planned)
    wrap_method(runtime, "select_setpoint", lambda _, obey, planned: (planned, runtime.verdict.tau))


def stop_instantly(runtime: Runtime) -> None:
    """Answer a refused setpoint by zero velocity at once, instead of the prepared stop."""

    def choose(nominal: Callable[..., tuple[Setpoint, Floats]], obey: Bools, planned: Setpoint) -> object:
        setpoint, tau = nominal(obey, planned)
        still = np.zeros_like(setpoint.qd)
        return select(obey, setpoint, setpoint._replace(q=runtime.smoother.q, qd=still, qdd=still)), tau

    wrap_method(runtime, "select_setpoint", choose)


def ignore_non_finite_action(runtime: Runtime) -> None:
    """Do not stop on non-finite actions; `Action` still ignores them."""

    def reasons(_: object) -> object:
        return runtime.verdict.reason | runtime.state.fault | runtime.requested_stop

    wrap_method(runtime, "stop_reasons", reasons)


def follow_non_finite_action(runtime: Runtime) -> None:
    """Let non-finite actions move the target."""

    def step(_: object, action: Floats, q_setpoint: Floats) -> object:
        runtime.action.value += runtime.action.scale * action
        return runtime.action.target

    wrap_method(runtime.action, "step", step)


def downgrade_to_category_2(reasons: Reason) -> GuardRemoval:
    """Handle these reasons as category 2: power stays on, and the robot resumes by itself."""

    def remove_guard(runtime: Runtime) -> None:
        def step(advance: Callable[..., Bools], *arguments: Any) -> Bools:
            runtime.supervisor.reason &= ~np.int64(reasons)
            return advance(*arguments)

        wrap_method(runtime.supervisor, "step", step)

    return remove_guard


class NeverMovingEstimator(Estimator):
    """Estimator that never reports a moving joint."""

    @property
    def moving(self) -> Bools:
        """Return False for every joint."""
        return np.zeros_like(self.joints.e, dtype=bool)


def arm_while_moving(runtime: Runtime) -> None:
    """Arm robots although a joint moves or creeps."""
    runtime.estimator = NeverMovingEstimator(runtime.spec, runtime.robot.robots)
    wrap_method(runtime.resting, "creeping", lambda _, q: np.zeros(q.shape, dtype=bool))


def trust_first_sample(runtime: Runtime) -> None:
    """Accept the estimate from the first sample on."""

    def now(step: Callable[..., State], t: float, *arguments: Any) -> State:
        return step(t, *arguments)._replace(age=(t - runtime.estimator.joints.t_sample).max(axis=1))

    wrap_method(runtime.estimator, "step", now)


def remove_foldback(runtime: Runtime) -> None:
    """Keep full current and speed of hot motors."""
    foldback = runtime.estimator.windings.foldback

    def step(fold_back: Callable[..., None], *heat: Any) -> None:
        fold_back(*heat)
        foldback.current_share[:] = foldback.speed_share[:] = 1.0

    wrap_method(foldback, "step", step)


def check_with_all_current(runtime: Runtime) -> None:
    """Check torques as if drives had all their current, however little the foldback leaves them."""

    def step(check: Callable[..., Verdict], state: State, *arguments: Any) -> Verdict:
        return check(state._replace(current_share=np.ones_like(state.current_share)), *arguments)

    wrap_method(runtime.safety, "step", step)


def freeze_lost_currents(runtime: Runtime) -> None:
    """Keep the last current after its sensor is lost."""
    wrap_method(runtime.estimator.windings, "check_sensors", lambda *_: None)


def _replace_smoother(change: Callable[[RobotSpec], RobotSpec]) -> GuardRemoval:
    def remove_guard(runtime: Runtime) -> None:
        runtime.smoother = make_smoother(change(runtime.spec), runtime.drives)

    return remove_guard


def use_full_speed(mode: ControlMode, share: float = 1.0) -> GuardRemoval:
    """Give the smoother a share of each joint's speed limit in place of the margin of a mode."""
    margin = {
        f"{mode.name.lower()}_mode": ModeMargins.model_construct(speed=share)
    }  # unchecked: it may be above 1
    return _replace_smoother(
        lambda spec: spec.model_copy(update={"margins": spec.margins.model_copy(update=margin)})
    )


def brake_too_late(rad: float) -> GuardRemoval:
    """Brake for ends of the joints' ranges that are farther away than the true ones."""

    def change(spec: RobotSpec) -> RobotSpec:
        ends = [{"q_min": joint.q_min - rad, "q_max": joint.q_max + rad} for joint in spec.joints]
        joints = (joint.model_copy(update=wide) for joint, wide in zip(spec.joints, ends, strict=True))
        return spec.model_copy(update={"joints": tuple(joints)})

    return _replace_smoother(change)


def remove_torque_bound(runtime: Runtime) -> None:
    """Follow target torques whatever motion they would cause."""
    wrap_method(runtime.smoother, "_bounded", lambda _, target, state: target)


def scale_torque_rates(factor: float) -> GuardRemoval:
    """Scale the rates at which torques follow their targets."""

    def remove_guard(runtime: Runtime) -> None:
        ramp: Any = attrgetter("smoother.ramp")(runtime)
        ramp._rate_max, ramp._rate_step = factor * ramp._rate_max, factor * ramp._rate_step

    return remove_guard


remove_torque_rate = override("smoother.ramp", _rate_max=np.inf)
remove_second_torque_rate = override("smoother.ramp", _rate_step=1e9)
take_over_stiffly = override("smoother.takeover", _ticks=0)
