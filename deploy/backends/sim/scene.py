"""A robot to look at, in the viewer and in films."""

import mujoco

from robots.arrays import Floats
from robots.models.mujoco_model import compile_model, read_mjcf
from robots.spec import RobotSpec

FLOOR = "firstshift/seen floor"
SQUARE_M, LIGHT, DARK = 0.5, (0.78, 0.8, 0.82), (0.66, 0.69, 0.72)


class Scene:
    """MuJoCo's nominal model, put where somebody says; a robot with a base gets a floor where model.xml has none.

    Attributes:
        model: of one robot. data: its pose.
    """

    def __init__(self, spec: RobotSpec) -> None:
        """Build it.

        Raises:
            RobotError: as `read_mjcf`.
        """
        mjcf = read_mjcf(spec)
        if spec.base:
            _add_floor(mjcf)
        self.model = compile_model(mjcf, spec.model_path)
        self.data, self._n = mujoco.MjData(self.model), spec.n

    def pose(self, q: Floats, base: Floats | None) -> None:
        """Joints at q (n,) rad, and a base (7,) at a place in the world, m, and an orientation, w first."""
        if base is not None:
            self.data.qpos[:7] = base
        self.data.qpos[-self._n :] = q
        mujoco.mj_forward(self.model, self.data)


def _add_floor(mjcf: mujoco.MjSpec) -> None:
    if any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in mjcf.worldbody.geoms):
        return
    checker = mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    mjcf.add_texture(
        name=FLOOR,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=checker,
        width=64,
        height=64,
        rgb1=LIGHT,
        rgb2=DARK,
    )
    mjcf.visual.headlight.ambient[:] = mjcf.visual.headlight.diffuse[:] = 0.45
    material = mjcf.add_material(name=FLOOR, texuniform=True, texrepeat=[0.5 / SQUARE_M] * 2)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = FLOOR
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    mjcf.worldbody.add_geom(name=FLOOR, type=plane, size=[0.0, 0.0, 1.0], material=FLOOR)
