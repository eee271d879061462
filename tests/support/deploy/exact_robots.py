"""Simulated robots as nominal as can be, whose sensors are exact and immediate but for their resolution."""

import numpy as np
import pytest

from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.randomness import robot_seed
from support.contracts import term
from support.deploy.plants import PLAIN

simulate = pytest.importorskip("deploy.simulation").simulate

_ERRORS = ("noise", "bias", "drift", "drift_per_k", "delay", "jitter", "loss", "repeat")
EXACT = PLAIN | {f"sensors.{name}": 0.0 for name in _ERRORS}


def exact_runtime(spec, contract, sources, changes=None, robots=1, **fields):
    """A runtime, not armed, on exact robots, that observes the sources as they are; `fields` of their terms."""
    known = {name: {} for name in sources} | fields
    terms = tuple(term(name, size(spec, name, known[name]), **known[name]) for name in sources)
    terms = tuple(each.model_copy(update={"scale": (1.0,) * each.size}) for each in terms)
    contract = contract(robot_digest=spec.digest, observation=terms)
    draw = median_draw(load_distributions(spec), spec, robots).replaced(EXACT | (changes or {}))
    return simulate(spec, contract, [robot_seed(3, k) for k in range(robots)], draw=draw)[0]


def size(spec, name, fields):
    from deploy.tasks.task import installed_sources

    legs = len(fields.get("phase_offsets", (0.0,)))
    return legs * installed_sources()[name].count(spec)


def observe(runtime, ticks=1, action=None):
    """Readings (B, size) by source at the last of some ticks in which the policy observes."""
    last = None
    for _ in range(ticks * runtime.decimation):
        seen = runtime.sense()
        last = seen if seen is not None else last
        shape = runtime.robot.robots, runtime.contract.action_size
        runtime.act(None if seen is None else np.zeros(shape) if action is None else action)
    ends = np.cumsum([each.size for each in runtime.contract.observation])
    return {
        each.source: last[:, end - each.size : end].astype(float)
        for each, end in zip(runtime.contract.observation, ends, strict=True)
    }
