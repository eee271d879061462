"""Inertia that a drive turns about its joint, over the working range of a robot."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.stats import qmc

from robots.arrays import Floats
from robots.models.nominal_model import load_pinocchio
from robots.spec import RobotSpec

POSES = 256


class JointInertia(NamedTuple):
    """Inertia about each joint, (n,) kg·m² each: smallest and largest with its rotor, and of the rotor alone.

    The smallest is that with all other joints free, the largest that with all others held. A floating base is held in
    both; a free one takes up to a sixth from the smallest (go1 and H1: 0.82 to 1.0 of it). In the play of its gear a
    drive turns the rotor alone; without rotors in the model it is taken to be the smallest.
    """

    least: Floats
    most: Floats
    rotor: Floats


def joint_inertia(spec: RobotSpec) -> JointInertia:
    """Return the inertias over `POSES` poses that fill the working range evenly.

    Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 6 (composite-rigid-body algorithm) and 7
    (1 / (M⁻¹)ᵢᵢ, the articulated inertia of one joint).

    Raises:
        RobotError: as `load_pinocchio`.
    """
    model, _ = load_pinocchio(spec)
    data, (low, high) = model.createData(), spec.pose_range
    places = qmc.Halton(spec.n, scramble=False).random(POSES)
    matrices = np.array([pin.crba(model, data, q).copy() for q in low + places * (high - low)])
    upper = np.triu(matrices)
    full = upper + np.triu(matrices, 1).swapaxes(1, 2)
    free = 1.0 / np.diagonal(np.linalg.inv(full), axis1=1, axis2=2)
    least, rotor = free.min(axis=0), np.array(model.armature)
    most = np.diagonal(full, axis1=1, axis2=2).max(axis=0)
    return JointInertia(least, most, np.where(rotor > 0.0, rotor, least))
