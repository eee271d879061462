"""Video of an event: the true pose, rendered by MuJoCo off screen."""

import importlib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from deploy.backends.sim.scene import Scene
from deploy.state import Mode
from deploy.telemetry.output_files import replacing
from eval.replay.replayer import Replay, ReplayResult
from robots.errors import ConfigError
from robots.spec import RobotSpec

WIDTH, HEIGHT = 480, 360
FRAME_S = 0.04
"""s of simulated time between two frames, played in real time."""
CONTEXTS = ("egl", "osmesa", "cgl", "glfw")
"""OpenGL backends, tried in this order; the first two need no display."""
GOAL_M = 0.02
LOAD_MAX = 1.5
"""Load at the end of the bar."""
RED, GREY, DARK, GREEN = (230, 70, 60), (235, 235, 235), (24, 26, 30), (0.1, 0.8, 0.3, 0.6)


class EventVideo:
    """Off-screen renderer of a robot."""

    def __init__(self, spec: RobotSpec) -> None:
        """Create the OpenGL context.

        Raises:
            ConfigError: OpenGL is not available.
        """
        self._context = opengl_context()
        self._context.make_current()
        self._robot, self._fixed = Scene(spec), "floating_base" not in spec.capabilities
        model = self._robot.model
        self._scene, self._options = mujoco.MjvScene(model, maxgeom=1000), mujoco.MjvOption()
        self._options.geomgroup[:] = 1
        self._camera, self._rect = mujoco.MjvCamera(), mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        if model.ncam and self._fixed:
            self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        else:
            mujoco.mjv_defaultFreeCamera(model, self._camera)
            self._camera.distance *= 1.25
        self._gl = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)

    def write(self, path: Path, replay: Replay, result: ReplayResult) -> None:
        """Write an animated GIF of the whole window; the bar at the bottom is the load, red above the limit.

        Raises:
            OutputError: it cannot be written.
        """
        event, dt = replay.info.event, replay.spec.dt
        # MuJoCo draws an infinite floor around the camera position of the frame before.
        self.render_row(result.rows[0])
        ticks, frames = max(1, round(FRAME_S / dt)), []
        for begin in range(0, len(result.rows), ticks):
            row, load = result.rows[begin], float(result.load[begin : begin + ticks].max())
            t, mode = (row["tick"] - event.start) * dt, Mode(int(row["mode"])).name
            text = f"{t:+.2f} s  {mode}  {event.monitor} {event.joint or ''}  load {load:.3f}"
            frames.append(_caption(self.render_row(row), text, load))
        with replacing(path) as file:
            options: dict[str, Any] = {"duration": round(1000 * ticks * dt), "loop": 0, "optimize": True}
            frames[0].save(file, format="GIF", save_all=True, append_images=frames[1:], **options)

    def render_row(self, row: Any) -> NDArray[np.uint8]:
        """Image (H, W, 3) of a pose and its goal; the camera follows a floating base."""
        if self._fixed:
            self._robot.pose(row["q_true"], None)
        else:
            self._robot.pose(row["q_true"], row["base_true"])
            self._camera.lookat[:] = row["base_true"][:3]
        categories = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._robot.model, self._robot.data, self._options, None, self._camera, categories, self._scene
        )
        if self._fixed:
            self._add_goal(row["goal"])
        image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
        mujoco.mjr_render(self._rect, self._scene, self._gl)
        mujoco.mjr_readPixels(image, None, self._rect, self._gl)
        return image[::-1]

    def _add_goal(self, goal: NDArray[np.float64]) -> None:
        if not np.isfinite(goal).all():
            return
        size, turn = np.full(3, GOAL_M), np.eye(3).ravel()
        geom = self._scene.geoms[self._scene.ngeom]
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_SPHERE, size, goal, turn, np.array(GREEN, np.float32))
        self._scene.ngeom += 1


def _caption(pixels: NDArray[np.uint8], text: str, load: float) -> Image.Image:
    image = Image.fromarray(pixels)
    draw = ImageDraw.Draw(image)
    colour = GREY if load <= 1 else RED
    draw.rectangle((0, HEIGHT - 42, WIDTH, HEIGHT), fill=DARK)
    draw.text((10, HEIGHT - 36), text, fill=colour, font_size=14)
    draw.rectangle(
        (10, HEIGHT - 14, 10 + round((WIDTH - 20) * min(load, LOAD_MAX) / LOAD_MAX), HEIGHT - 8), fill=colour
    )
    limit = 10 + (WIDTH - 20) / LOAD_MAX
    draw.line((limit, HEIGHT - 18, limit, HEIGHT - 4), fill=GREY)
    return image


def opengl_context() -> Any:
    """Return an OpenGL context of the first backend that works; each raises its own exception if not installed."""
    for name in CONTEXTS:
        try:
            return importlib.import_module(f"mujoco.{name}").GLContext(WIDTH, HEIGHT)
        except Exception as e:  # noqa: BLE001
            error = e
    raise ConfigError(f"--video: needs OpenGL, found none of {', '.join(CONTEXTS)}: {error!s:.200}")
