"""Scene for the viewer and for videos: MuJoCo's nominal model of one robot at a given pose."""

import mujoco
import numpy as np

from robots.arrays import Floats
from robots.models.files import OWN
from robots.models.mujoco_model import compile_model, read_mjcf
from robots.spec import RobotSpec

FLOOR = f"{OWN}visible floor"
GREEN, GOAL_M = (0.1, 0.8, 0.3, 0.6), 0.02
"""Colour, and radius where nothing else is known, of the sphere at a goal."""
SQUARE_M, LIGHT, DARK = 0.5, (0.78, 0.8, 0.82), (0.66, 0.69, 0.72)


class Scene:
    """Model of one robot; one with a floating base gets a floor if model.xml has none.

    Attributes:
        model: MuJoCo's. data: its pose.
    """

    def __init__(self, spec: RobotSpec) -> None:
        """Compile the model.

        Raises:
            RobotError: as `read_mjcf`.
        """
        mjcf = read_mjcf(spec)
        if "floating_base" in spec.capabilities:
            _add_floor(mjcf)
        self.model = compile_model(mjcf, spec.model_path)
        self.data, self._n = mujoco.MjData(self.model), spec.n

    def pose(self, q: Floats, base: Floats | None) -> None:
        """Set joints (n,) rad and base (7,): position in the world, m, orientation, w first; None where mounted."""
        if base is not None:
            self.data.qpos[:7] = base
        self.data.qpos[-self._n :] = q
        mujoco.mj_forward(self.model, self.data)


def add_goal(scene: mujoco.MjvScene, goal: Floats, radius: float) -> None:
    """Add a sphere at a goal (3,) m, world, to what is drawn; none where it is not finite."""
    if not np.isfinite(goal).all():
        return
    geom, sphere = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_SPHERE
    mujoco.mjv_initGeom(
        geom, sphere, np.full(3, radius), goal, np.eye(3).ravel(), np.array(GREEN, np.float32)
    )
    scene.ngeom += 1


def _add_floor(mjcf: mujoco.MjSpec) -> None:
    if any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in mjcf.worldbody.geoms):
        return
    texture = mjcf.add_texture(name=FLOOR, type=mujoco.mjtTexture.mjTEXTURE_2D, width=64, height=64)
    texture.builtin, texture.rgb1, texture.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_CHECKER, LIGHT, DARK
    mjcf.visual.headlight.ambient[:] = mjcf.visual.headlight.diffuse[:] = 0.45
    material = mjcf.add_material(name=FLOOR, texuniform=True, texrepeat=[0.5 / SQUARE_M] * 2)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = FLOOR
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    mjcf.worldbody.add_geom(name=FLOOR, type=plane, size=[0.0, 0.0, 1.0], material=FLOOR)
