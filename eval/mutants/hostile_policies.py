"""What hostile policies ask for, at every step of theirs: actions (B, A), before clip and scale."""

import numpy as np

from deploy.runtime import Runtime
from eval.mutants.situation import HostilePolicy
from robots.arrays import Floats


def move_to(**to: float) -> HostilePolicy:
    """Some joints are to be at so many rad, as fast as they are let; the others at home."""

    def says(runtime: Runtime) -> Floats:
        q = runtime.spec.joint_array("q_home").copy()
        for name, value in to.items():
            q[runtime.spec.joint_names.index(name)] = value
        return np.asarray((q - runtime.action.q) / runtime.contract.action.scale)

    return says


def cycle_poses(every_s: float, *poses: dict[str, float]) -> HostilePolicy:
    """One pose after the other, again and again."""
    each = [move_to(**pose) for pose in poses]
    return lambda runtime: each[int(runtime.t / every_s) % len(each)](runtime)


def switch_policy(t: float, first: HostilePolicy, second: HostilePolicy) -> HostilePolicy:
    """One policy until s, another from there on."""
    return lambda runtime: (first if runtime.t < t else second)(runtime)


def move_slowly_to(rad_s: float, **to: float) -> HostilePolicy:
    """As `heads`, no joint faster than this."""
    go = move_to(**to)

    def says(runtime: Runtime) -> Floats:
        most = rad_s / runtime.contract.policy_hz / np.array(runtime.contract.action.scale)
        return np.clip(go(runtime), -most, most)

    return says


def turn_last_joint(until: float) -> HostilePolicy:
    """The last joint turns at full action until s, and is then left alone."""
    return lambda runtime: _last(runtime, float(runtime.t < until))


def action_spike(t: float, until: float, **near: float) -> HostilePolicy:
    """As `heads`, but from s to s the last joint is to move by 100, where 1 is the most, and is then left alone."""
    go = move_to(**near)
    return lambda runtime: go(runtime) if runtime.t < t else _last(runtime, 100.0 * (runtime.t < until))


def nan_after(t: float, **to: float) -> HostilePolicy:
    """As `heads`; from s on what it says is no number."""
    go = move_to(**to)
    return lambda runtime: np.full_like(runtime.action.last, np.nan) if runtime.t >= t else go(runtime)


def _last(runtime: Runtime, value: float) -> Floats:
    action = np.zeros_like(runtime.action.last)
    action[:, -1] = value
    return action
