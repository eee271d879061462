"""Loads of drawn robots: how much of their joints' torque masses and pushes may take beyond the nominal model."""

import numpy as np

from robots.arrays import Floats
from robots.draws import Draw
from robots.models.levers import levers_of_point, tool_levers
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.spec import RobotSpec

G = 9.81
"""m/s²."""


def extra_load(spec: RobotSpec, robots: Draw) -> Floats:
    """Return (B,) the largest share of a joint's range that extra mass, payload and a push take together.

    Forces act at their longest levers, in no pose at once: for comparing robots with each other.
    """
    model, _ = load_pinocchio(spec)
    masses = np.array([each.mass for each in model.inertias[1:]])
    arms = np.array(
        [
            levers_of_point(model, 1 + k, float(np.linalg.norm(model.inertias[1 + k].lever)))
            for k in range(spec.n)
        ]
    )
    tau = G * (masses * (robots["links.mass"] - 1.0)) @ arms
    tau += np.outer(G * robots["payload.mass_kg"] + robots["push.force_n"], tool_levers(spec, model))
    return np.asarray((tau / torque_max(spec)).max(axis=1))
