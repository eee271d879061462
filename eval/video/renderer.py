"""Off-screen images of one robot, rendered by MuJoCo."""

import importlib
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.scene import Scene, add_goal
from deploy.operation.interrupts import not_dropped
from robots.arrays import Floats
from robots.errors import ConfigError
from robots.spec import RobotSpec

WIDTH, HEIGHT = 480, 360
CONTEXTS = ("egl", "osmesa", "cgl", "glfw")
"""OpenGL backends, tried in this order; the first two need no display."""

Image = NDArray[np.uint8]


class Renderer:
    """Renderer of one robot in its nominal model, and of a goal as a sphere."""

    def __init__(self, spec: RobotSpec, option: str = "--video") -> None:
        """Create the OpenGL context; an error names the `option` that asked for it.

        Raises:
            ConfigError: OpenGL is not available.
        """
        self._robot, self._fixed = Scene(spec), "floating_base" not in spec.capabilities
        model = self._robot.model
        self._context, self._gl = opengl_contexts(model, option)
        self._scene, self._options = mujoco.MjvScene(model, maxgeom=1000), mujoco.MjvOption()
        self._options.geomgroup[:] = 1
        self._camera, self._rect = mujoco.MjvCamera(), mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        if model.ncam and self._fixed:
            self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        else:
            mujoco.mjv_defaultFreeCamera(model, self._camera)
            self._camera.distance *= 1.25
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)

    def image(self, q: Floats, base: Floats | None, goal: Floats, goal_m: float) -> Image:
        """Image (H, W, 3) of a pose and its goal; the camera follows a floating base.

        Args:
            q: (n,) rad. base: (7,) position in the world, m, and orientation, w first; None where mounted.
            goal: (3,) m, world; not finite: none is shown. goal_m: radius of its sphere.
        """
        self._context.make_current()
        self._robot.pose(q, base)
        if base is not None:
            self._camera.lookat[:] = base[:3]
        categories = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._robot.model, self._robot.data, self._options, None, self._camera, categories, self._scene
        )
        add_goal(self._scene, goal, goal_m)
        image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
        mujoco.mjr_render(self._rect, self._scene, self._gl)
        mujoco.mjr_readPixels(image, None, self._rect, self._gl)
        return image[::-1].copy()

    def close(self) -> None:
        """Release the OpenGL context."""
        self._context.make_current()
        self._gl.free()
        self._context.free()


def opengl_contexts(model: mujoco.MjModel, option: str) -> tuple[Any, mujoco.MjrContext]:
    """Return an OpenGL context of the first backend that works, and MuJoCo's in it.

    Raises:
        ConfigError: none works, each for its own reason.
    """
    errors = []
    with not_dropped():  # ctypes makes an error of its own of an interrupt
        for name in CONTEXTS:
            try:
                context = importlib.import_module(f"mujoco.{name}").GLContext(WIDTH, HEIGHT)
                context.make_current()
                return context, mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
            except Exception as e:  # noqa: BLE001
                errors.append(f"{name} ({e!s:.80})")
    raise ConfigError(f"{option}: needs OpenGL, found none of {', '.join(errors)}")
