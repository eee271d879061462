"""Every robot's own body, by its draw: values of the model that differ from simulation to simulation."""

import mujoco
import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.anatomy import Anatomy
from deploy.estimation.rotations import from_up
from robots.arrays import Floats
from robots.draws import Draw

R, K, ALPHA, COLD, KP, KD, VOLTS = 0, 1, 2, 3, 4, 6, 7
"""Places in a dcmotor's `gainprm` of resistance, motor constant, the resistance's coefficient of temperature and the
temperature that it is of, drive gains and voltage limit."""
RWH, CW, AMBIENT = 2, 3, 4
"""Places of winding-to-housing resistance, of the winding's capacity and of ambient temperature in `dynprm`."""

_LONG = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
"""Shapes with a half-length, `size[1]`, that grows with the link; the others keep their size and only move."""


def embody(batch: Batch, anatomy: Anatomy, draw: Draw) -> None:
    """Write what the draw says about links, joints, drives, mounting and cable, and derive what follows from it."""
    _links(batch, anatomy, draw)
    _joints(batch, anatomy, draw)
    _drives(batch, draw)
    _mounting(batch, anatomy, draw)
    _cable(batch, anatomy, draw)
    batch.set_const()


def _links(batch: Batch, anatomy: Anatomy, draw: Draw) -> None:
    """A link is all that its joint moves up to the next: its mass and inertia together, and every way inside it."""
    model, expand = anatomy.model, batch.expand
    moving = np.flatnonzero(anatomy.link >= 0)
    mass = draw["links.mass"][:, anatomy.link[moving]]
    expand("body_mass")[:, moving] *= mass
    expand("body_inertia")[:, moving] *= mass[:, :, None]
    longer = np.ones((batch.nsim, model.nbody))
    longer[:, moving] = draw["links.length"][:, anatomy.link[moving]]
    expand("body_pos")[:] *= longer[:, model.body_parentid, None]
    expand("body_ipos")[:] *= longer[:, :, None]
    expand("body_ipos")[:, anatomy.bodies] += draw["links.com_m"]
    expand("site_pos")[:] *= longer[:, model.site_bodyid, None]
    expand("geom_pos")[:] *= longer[:, model.geom_bodyid, None]
    long = np.flatnonzero(np.isin(model.geom_type, _LONG))
    expand("geom_size")[:, long, 1] *= longer[:, model.geom_bodyid[long]]


def _joints(batch: Batch, anatomy: Anatomy, draw: Draw) -> None:
    """All but their play, which grows: see `Wear`."""
    dofs = anatomy.dofs
    for field, name in (("frictionloss", "friction"), ("damping", "damping"), ("armature", "armature")):
        batch.expand(f"dof_{field}")[:, dofs] *= draw[f"joints.{name}"]


def _drives(batch: Batch, draw: Draw) -> None:
    gain = batch.expand("actuator_gainprm")
    for place, name in ((R, "resistance"), (K, "torque_constant"), (KP, "kp"), (KD, "kd")):
        gain[:, :, place] *= draw[f"drives.{name}"]
    gain[:, :, VOLTS] *= draw["drives.voltage"][:, None]
    dynamics = batch.expand("actuator_dynprm")
    for place, name in ((RWH, "winding_to_housing"), (CW, "winding_capacity")):
        dynamics[:, :, place] *= draw[f"drives.{name}"]


def _mounting(batch: Batch, anatomy: Anatomy, draw: Draw) -> None:
    gravity = tilted(anatomy.model.opt.gravity, draw["mounting.tilt_rad"])
    batch.expand("opt.gravity")[:] = gravity
    if anatomy.level is not None:
        batch.expand("body_quat")[:, anatomy.level] = from_up(-gravity) * (1, -1, -1, -1)  # its inverse
    batch.expand("geom_friction")[:, :, 0] *= draw["mounting.contact_friction"][:, None]


def tilted(gravity: Floats, tilt_rad: Floats) -> Floats:
    """(B, 3) gravity (3,) as seen from bases that stand turned about x, then about their own y, by tilt (B, 2) rad."""
    (sin_x, sin_y), (cos_x, cos_y) = np.sin(tilt_rad).T, np.cos(tilt_rad).T
    x, y, z = gravity
    y, z = y * cos_x + z * sin_x, z * cos_x - y * sin_x
    x, z = x * cos_y - z * sin_y, z * cos_y + x * sin_y
    return np.stack((x, y, z), axis=-1)


def _cable(batch: Batch, anatomy: Anatomy, draw: Draw) -> None:
    batch.expand("site_pos")[:, anatomy.anchor] += draw["cable.anchor_m"]
    batch.expand("tendon_stiffness")[:, anatomy.cable] = draw["cable.stiffness_n_per_m"]
    batch.expand("tendon_lengthspring")[:, anatomy.cable, 1] = draw["cable.length_m"]
