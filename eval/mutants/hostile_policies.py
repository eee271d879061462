"""Hostile policies: functions returning actions (B, A), before clip and scale, at each policy step."""

import numpy as np

from deploy.runtime import Runtime
from eval.mutants.situation import HostilePolicy
from robots.arrays import Floats


def move_to(**to: float) -> HostilePolicy:
    """Move the named joints to positions in rad as fast as allowed, and the others to the home pose."""

    def policy(runtime: Runtime) -> Floats:
        q = runtime.spec.joint_array("q_home").copy()
        for name, value in to.items():
            q[runtime.spec.joint_names.index(name)] = value
        return np.asarray((q - runtime.action.q) / runtime.contract.action.scale)

    return policy


def cycle_poses(every_s: float, *poses: dict[str, float]) -> HostilePolicy:
    """Move through poses cyclically, changing every `every_s` s."""
    each = [move_to(**pose) for pose in poses]
    return lambda runtime: each[int(runtime.t / every_s) % len(each)](runtime)


def switch_policy(t: float, first: HostilePolicy, second: HostilePolicy) -> HostilePolicy:
    """Use the first policy until `t` s, and then the second."""
    return lambda runtime: (first if runtime.t < t else second)(runtime)


def move_slowly_to(rad_s: float, **to: float) -> HostilePolicy:
    """Move to positions with limited speed, rad/s."""
    go = move_to(**to)

    def policy(runtime: Runtime) -> Floats:
        most = rad_s / runtime.contract.policy_hz / np.array(runtime.contract.action.scale)
        return np.clip(go(runtime), -most, most)

    return policy


def turn_last_joint(until: float) -> HostilePolicy:
    """Apply full action to the last joint until `until` s, and then none."""
    return lambda runtime: _last(runtime, float(runtime.t < until))


def action_spike(t: float, until: float, **near: float) -> HostilePolicy:
    """Move to positions; from `t` to `until` s apply an action of 100 (clip: 1) to the last joint, and then none."""
    go = move_to(**near)
    return lambda runtime: go(runtime) if runtime.t < t else _last(runtime, 100.0 * (runtime.t < until))


def nan_after(t: float, **to: float) -> HostilePolicy:
    """Move to positions; from `t` s on return NaN actions."""
    go = move_to(**to)
    return lambda runtime: np.full_like(runtime.action.last, np.nan) if runtime.t >= t else go(runtime)


def _last(runtime: Runtime, value: float) -> Floats:
    action = np.zeros_like(runtime.action.last)
    action[:, -1] = value
    return action
