"""Predicted effect of a push that throws a link through the play of its gear."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.stats import qmc

from eval.attack.loaded_robots import LIVES
from robots.arrays import Floats
from robots.draws import Draw
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.drive_gains import drive_gains
from robots.spec import RobotSpec

POSES = 32


class Throws(NamedTuple):
    """Largest effects over poses.

    Attributes:
        speed: (B, n, n) of each link, by a push on each link, as a share of its joint's limit of speed.
        torque: (B, n, n) of the damping of the drive whose rotor the link then hits, as a share of its range.
        tool: (B,) m/s of the end of the arm, by a push on the last link that throws all links in the same direction.
    """

    speed: Floats
    torque: Floats
    tool: Floats


def throws(spec: RobotSpec, robots: Draw) -> Throws:
    """Return the throws of B robots at the end of their lives over `POSES` poses that fill the working range evenly.

    A link of inertia I that a force F pushes with lever l reaches √(2·F·l·play / I) at the end of its play. Together
    with a rotor of inertia J it goes on with I / (I + J) of that speed. Other joints are held.
    """
    model, _ = load_pinocchio(spec)
    data, (low, high) = model.createData(), spec.pose_range
    play = robots["joints.backlash_rad"] + LIVES * robots["wear.backlash_rad"]
    work = 2.0 * robots["push.force_n"][:, None] * play
    damping = drive_gains(spec).kd * spec.joint_array("qd_max") / torque_max(spec)
    speed, torque, tool = *np.zeros((2, len(work), spec.n, spec.n)), np.zeros(len(work))
    for place in qmc.Halton(spec.n, scramble=False).random(POSES):
        levers, inertia = _levers_and_inertia(model, data, robots, low + place * (high - low))
        thrown = np.sqrt(work[:, :, None] * levers / inertia[:, :, None])
        reached = thrown / spec.joint_array("qd_max")[:, None]
        struck = damping * inertia / (inertia + model.armature)
        np.maximum(speed, reached, out=speed)
        np.maximum(torque, struck[:, :, None] * reached, out=torque)
        np.maximum(tool, np.sum(thrown[:, :, -1] * levers[:, :, -1], axis=1), out=tool)
    return Throws(speed, torque, tool)


def _levers_and_inertia(model: pin.Model, data: pin.Data, robots: Draw, q: Floats) -> tuple[Floats, Floats]:
    """Return levers (B, n, n), m, of drawn centres of mass of links about joints, and inertias (B, n), kg·m²."""
    n, masses, centres = len(q), robots["links.mass"], robots["links.com_m"]
    levers, inertia = np.zeros((len(masses), n, n)), np.zeros((len(masses), n))
    pin.computeJointJacobians(model, data, q)
    for link in range(n):
        body = model.inertias[link + 1]
        jacobian = pin.getJointJacobian(model, data, link + 1, pin.LOCAL_WORLD_ALIGNED)
        rotation = data.oMi[link + 1].rotation
        centre = (body.lever + centres[:, link]) @ rotation.T
        moved = jacobian[:3].T + np.cross(jacobian[3:].T, centre[:, None])
        levers[:, :, link] = np.linalg.norm(moved, axis=2)
        turned = rotation.T @ jacobian[3:]
        own = np.einsum("an,ab,bn->n", turned, body.inertia, turned)
        inertia += masses[:, link, None] * (body.mass * levers[:, :, link] ** 2 + own)
    return levers, inertia
