import numpy as np
import pytest

from deploy.state import Command
from robots.distributions import load_distributions
from robots.draws import Draw, draw
from robots.randomness import robot_seed
from support.arm6 import SPEC, position_drives

Plant = pytest.importorskip("deploy.backends.sim.plant").Plant
build = pytest.importorskip("deploy.backends.sim.model.plant_model").build


N, DT = SPEC.n, SPEC.dt
HOME = SPEC.joint_array("q_home")
PLANT_MODEL = build(SPEC, load_distributions(SPEC).cable)
FACTORS = (
    *("links.mass", "links.length", "joints.friction", "joints.damping", "joints.armature"),
    *("drives.kp", "drives.kd", "drives.torque_constant", "drives.resistance", "drives.voltage"),
    *("drives.winding_to_housing", "drives.winding_capacity"),
    *("drives.housing_to_ambient", "drives.housing_capacity"),
    "mounting.contact_friction",
)
AMOUNTS = (
    *("links.com_m", "joints.backlash_rad", "drives.supply_ohm", "drives.delay_s", "drives.iron_loss"),
    *(
        "mounting.tilt_rad",
        "payload.mass_kg",
        "cable.stiffness_n_per_m",
        "push.force_n",
        "climate.warm_start_k",
    ),
    *("wear.friction", "wear.backlash_rad", "wear.encoder_rad", "wear.torque_constant"),
)
PLAIN = dict.fromkeys(FACTORS, 1.0) | dict.fromkeys(AMOUNTS, 0.0) | {"climate.ambient_c": 25.0}
"""A robot without a lie, on which nobody pulls."""
BUSY = {"push.every_s": 1.0, "push.lasts_s": 0.1, "payload.carried_s": 0.4, "payload.free_s": 0.3}
"""Much happens in a second."""


def drawn(robots=1, changes=None, *, rows=slice(None), spec=SPEC, threads=1):
    """Robots as they may be, but for some quantities; of those, some rows."""
    seeds = [robot_seed(1, robot) for robot in range(robots)]
    d = draw(load_distributions(spec), spec, seeds).replaced(changes or {})
    d = Draw({name: values[rows] for name, values in d.items()})
    return Plant(spec, load_distributions(spec), d, seeds[rows], threads=threads)


def exact(robots=1, changes=None, **how):
    """Robots without a lie, but those that are named."""
    return drawn(robots, PLAIN | (changes or {}), **how)


def command(q, qd=0.0, tau=0.0, powered=True, current=1.0, spec=SPEC):
    q = np.atleast_2d(q)
    return Command(
        drive=position_drives(len(q), spec),
        q=q,
        qd=np.broadcast_to(qd, q.shape),
        tau=np.broadcast_to(tau, q.shape),
        powered=np.broadcast_to(powered, len(q)),
        current_share=np.broadcast_to(current, q.shape),
    )
