"""What hostile policies ask for, at every step of theirs: actions (B, A), before clip and scale."""

import numpy as np

from deploy.runtime import Runtime
from eval.mutants.hostile import Says
from robots.arrays import Floats


def heads(**to: float) -> Says:
    """Some joints are to be at so many rad, as fast as they are let; the others at home."""

    def says(runtime: Runtime) -> Floats:
        q = runtime.spec.joint_array("q_home").copy()
        for name, value in to.items():
            q[runtime.spec.joint_names.index(name)] = value
        return np.asarray((q - runtime.action.q) / runtime.contract.action.scale)

    return says


def visits(every_s: float, *poses: dict[str, float]) -> Says:
    """One pose after the other, again and again."""
    each = [heads(**pose) for pose in poses]
    return lambda runtime: each[int(runtime.t / every_s) % len(each)](runtime)


def then(t: float, first: Says, second: Says) -> Says:
    """One policy until s, another from there on."""
    return lambda runtime: (first if runtime.t < t else second)(runtime)


def creeps(rad_s: float, **to: float) -> Says:
    """As `heads`, no joint faster than this."""
    go = heads(**to)

    def says(runtime: Runtime) -> Floats:
        most = rad_s / runtime.contract.policy_hz / np.array(runtime.contract.action.scale)
        return np.clip(go(runtime), -most, most)

    return says


def turns(until: float) -> Says:
    """The last joint turns at full action until s, and is then left alone."""
    return lambda runtime: _last(runtime, float(runtime.t < until))


def shouts(t: float, until: float, **near: float) -> Says:
    """As `heads`, but from s to s the last joint is to move by 100, where 1 is the most, and is then left alone."""
    go = heads(**near)
    return lambda runtime: go(runtime) if runtime.t < t else _last(runtime, 100.0 * (runtime.t < until))


def falls_silent(t: float, **to: float) -> Says:
    """As `heads`; from s on what it says is no number."""
    go = heads(**to)
    return lambda runtime: np.full_like(runtime.action.last, np.nan) if runtime.t >= t else go(runtime)


def _last(runtime: Runtime, value: float) -> Floats:
    action = np.zeros_like(runtime.action.last)
    action[:, -1] = value
    return action
