"""Parameters that differ from simulation to simulation, written into the models of B plants by their draws."""

import mujoco
import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.model import motor_parameters as motor
from deploy.backends.sim.model.plant_model import PlantModel
from robots.arrays import Floats
from robots.draws import Draw
from robots.rotations import from_up

_WITH_HALF_LENGTH = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
"""Shapes with a half-length, `size[1]`, that grows with the link; the others keep their size and only move."""


def write_draw(batch: Batch, plant: PlantModel, draw: Draw) -> None:
    """Write links, joints, drives, mounting and cable, and derive MuJoCo's constants from them."""
    _write_links(batch, plant, draw)
    _write_joints(batch, plant, draw)
    _write_drives(batch, draw)
    _write_mounting(batch, plant, draw)
    _write_cable(batch, plant, draw)
    batch.set_const()


def _write_links(batch: Batch, plant: PlantModel, draw: Draw) -> None:
    """Scale each link, which is all that its joint moves up to the next: mass with inertia, and all lengths in it."""
    model, expand = plant.model, batch.expand
    moving = np.flatnonzero(plant.link >= 0)
    mass = draw["links.mass"][:, plant.link[moving]]
    expand("body_mass")[:, moving] *= mass
    expand("body_inertia")[:, moving] *= mass[:, :, None]
    scale = np.ones((batch.nsim, model.nbody))
    scale[:, moving] = draw["links.length"][:, plant.link[moving]]
    expand("body_pos")[:] *= scale[:, model.body_parentid, None]
    expand("body_ipos")[:] *= scale[:, :, None]
    expand("body_ipos")[:, plant.bodies] += draw["links.com_m"]
    expand("site_pos")[:] *= scale[:, model.site_bodyid, None]
    expand("geom_pos")[:] *= scale[:, model.geom_bodyid, None]
    long = np.flatnonzero(np.isin(model.geom_type, _WITH_HALF_LENGTH))
    expand("geom_size")[:, long, 1] *= scale[:, model.geom_bodyid[long]]


def _write_joints(batch: Batch, plant: PlantModel, draw: Draw) -> None:
    """Write all but the backlash, which grows: see `Wear`."""
    for field, name in (("frictionloss", "friction"), ("damping", "damping"), ("armature", "armature")):
        batch.expand(f"dof_{field}")[:, plant.dofs] *= draw[f"joints.{name}"]


def _write_drives(batch: Batch, draw: Draw) -> None:
    gain = batch.expand("actuator_gainprm")
    for name in ("resistance", "torque_constant", "kp", "kd"):
        gain[:, :, getattr(motor, name.upper())] *= draw[f"drives.{name}"]
    gain[:, :, motor.VOLTAGE_MAX] *= draw["drives.voltage"][:, None]
    dynamics = batch.expand("actuator_dynprm")
    for name in ("winding_to_housing", "winding_capacity"):
        dynamics[:, :, getattr(motor, name.upper())] *= draw[f"drives.{name}"]


def _write_mounting(batch: Batch, plant: PlantModel, draw: Draw) -> None:
    gravity = tilted(plant.model.opt.gravity, draw["mounting.tilt_rad"])
    batch.expand("opt.gravity")[:] = gravity
    if plant.level is not None:
        batch.expand("body_quat")[:, plant.level] = from_up(-gravity) * (1, -1, -1, -1)  # its inverse
    batch.expand("geom_friction")[:, :, 0] *= draw["mounting.contact_friction"][:, None]


def tilted(gravity: Floats, tilt_rad: Floats) -> Floats:
    """Return gravity (B, 3) of (3,) m/s² in the frame of a base tilted (B, 2) rad about x, then about its own y."""
    (sin_x, sin_y), (cos_x, cos_y) = np.sin(tilt_rad).T, np.cos(tilt_rad).T
    x, y, z = gravity
    y, z = y * cos_x + z * sin_x, z * cos_x - y * sin_x
    x, z = x * cos_y - z * sin_y, z * cos_y + x * sin_y
    return np.stack((x, y, z), axis=-1)


def _write_cable(batch: Batch, plant: PlantModel, draw: Draw) -> None:
    batch.expand("site_pos")[:, plant.anchor] += draw["cable.anchor_m"]
    batch.expand("tendon_stiffness")[:, plant.cable] = draw["cable.stiffness_n_per_m"]
    batch.expand("tendon_lengthspring")[:, plant.cable, 1] = draw["cable.length_m"]
