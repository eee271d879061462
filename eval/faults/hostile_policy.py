"""Hostile policies in velocity and torque mode: random actions, shaking, pushes towards the ends of all joints."""

from collections.abc import Callable

import numpy as np

from deploy.runtime import Runtime
from robots.arrays import Floats

HostilePolicy = Callable[[Runtime], Floats]
"""Function returning actions (B, A) before clip and scale."""


def random_actions(seed: int) -> HostilePolicy:
    """Return a policy of independent actions in [-1, 1] at every step."""
    rng = np.random.default_rng(seed)
    return lambda runtime: rng.uniform(-1.0, 1.0, runtime.target.value.shape)


def shake(runtime: Runtime) -> Floats:
    """Full actions that follow each joint's own speed."""
    state = runtime.state
    return np.sign(state.qd + 0.02 * np.sin(977.0 * state.q))


def push_joints(every_s: float, seed: int) -> HostilePolicy:
    """Return a policy of full actions with random signs, which change every `every_s` s."""

    def policy(runtime: Runtime) -> Floats:
        rng = np.random.default_rng([seed, int(runtime.t / every_s)])
        return rng.choice([-1.0, 1.0], runtime.target.value.shape)

    return policy


def shake_and_push(phase_s: float, push_s: float, seed: int) -> HostilePolicy:
    """Return a policy that shakes for `phase_s` s, then pushes for as long, each push for `push_s` s, and so on."""
    push = push_joints(push_s, seed)
    return lambda runtime: (shake if runtime.t % (2.0 * phase_s) < phase_s else push)(runtime)
