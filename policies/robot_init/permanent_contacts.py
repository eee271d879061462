"""Pairs of bodies whose capsules touch in every pose and must be excluded from collision checks."""

from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np

from policies.robot_init.vendor_model import VendorModel
from robots.models.files import OWN
from robots.models.mujoco_model import compile_model, open_model

POSES = 200
NEAR_M = 0.02
"""m, distance that counts as touching, including the collision margin."""


def permanent_contacts(path: Path, folder: Path, vendor: VendorModel) -> tuple[tuple[str, str], ...]:
    """Return pairs of bodies that touch in all of `POSES` random poses, except on the same or adjacent links."""
    mjcf = open_model(path, folder)
    for number, shape in enumerate(vendor.shapes):
        line = [*shape.start, *shape.end]
        kind, size = mujoco.mjtGeom.mjGEOM_CAPSULE, [shape.radius, 0.0, 0.0]
        mjcf.body(shape.body).add_geom(name=f"{OWN}{number}", type=kind, fromto=line, size=size)
    model = compile_model(mjcf, path)
    geoms = [model.geom(f"{OWN}{number}").id for number in range(len(vendor.shapes))]
    pairs = [(a, b) for a, b in combinations(geoms, 2) if _on_separate_links(model, a, b)]
    pairs = _touching_in_all_poses(model, vendor, pairs)
    bodies = [tuple(model.body(model.geom_bodyid[geom]).name for geom in pair) for pair in pairs]
    return tuple(dict.fromkeys((a, b) for a, b in bodies))


def _touching_in_all_poses(
    model: mujoco.MjModel, vendor: VendorModel, pairs: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(POSES):
        for joint in vendor.joints:
            data.joint(joint.name).qpos = 0.0 if joint.name in vendor.locked else rng.uniform(*joint.span)
        mujoco.mj_kinematics(model, data)
        pairs = [pair for pair in pairs if mujoco.mj_geomDistance(model, data, *pair, NEAR_M, None) < NEAR_M]
    return pairs


def _on_separate_links(model: mujoco.MjModel, a: int, b: int) -> bool:
    """Return True for shapes on links that are neither the same nor parent and child."""
    weld, parent = model.body_weldid, model.body_parentid
    one, other = (int(weld[model.geom_bodyid[geom]]) for geom in (a, b))
    return one != other and weld[parent[one]] != other and weld[parent[other]] != one
