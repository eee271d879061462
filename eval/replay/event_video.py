"""An event as a moving picture: the true pose, rendered by MuJoCo off screen."""

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
from eval.replay.replayer import Again, Replay
from robots.errors import ConfigError
from robots.spec import RobotSpec

WIDTH, HEIGHT = 480, 360
FRAME_S = 0.04
"""s of the robot's time between two pictures; they are shown in the same time."""
CONTEXTS = ("egl", "osmesa", "cgl", "glfw")
"""Ways to OpenGL, tried in this order: the first two need no display."""
GOAL_M = 0.02
LOAD_MAX = 1.5
"""At the end of the bar."""
RED, GREY, DARK, GREEN = (230, 70, 60), (235, 235, 235), (24, 26, 30), (0.1, 0.8, 0.3, 0.6)


class Film:
    """MuJoCo's renderer, without a window."""

    def __init__(self, spec: RobotSpec) -> None:
        """Open it.

        Raises:
            ConfigError: there is no OpenGL.
        """
        self._context = _context()
        self._context.make_current()
        self._robot, self._stands = Scene(spec), spec.base is None
        model = self._robot.model
        self._scene, self._options = mujoco.MjvScene(model, maxgeom=1000), mujoco.MjvOption()
        self._options.geomgroup[:] = 1
        self._camera, self._rect = mujoco.MjvCamera(), mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        if model.ncam and self._stands:
            self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        else:
            mujoco.mjv_defaultFreeCamera(model, self._camera)
            self._camera.distance *= 1.25
        self._gl = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)

    def write(self, path: Path, replay: Replay, again: Again) -> None:
        """An animated GIF of the whole window; the bar below is the load, red above the limit.

        Raises:
            OutputError: it cannot be written.
        """
        event, dt = replay.about.event, replay.spec.dt
        # MuJoCo lays an endless floor to where the camera was in the picture before.
        self._picture(again.rows[0])
        every, frames = max(1, round(FRAME_S / dt)), []
        for begin in range(0, len(again.rows), every):
            row, load = again.rows[begin], float(again.load[begin : begin + every].max())
            t, mode = (row["tick"] - event.start) * dt, Mode(int(row["mode"])).name
            said = f"{t:+.2f} s  {mode}  {event.monitor} {event.joint or ''}  load {load:.3f}"
            frames.append(_caption(self._picture(row), said, load))
        with replacing(path) as file:
            how: dict[str, Any] = {"duration": round(1000 * every * dt), "loop": 0, "optimize": True}
            frames[0].save(file, format="GIF", save_all=True, append_images=frames[1:], **how)

    def _picture(self, row: Any) -> NDArray[np.uint8]:
        """(H, W, 3) of a pose, with its goal; of a robot that walks, from beside it."""
        if self._stands:
            self._robot.pose(row["q_true"], None)
        else:
            self._robot.pose(row["q_true"], row["base_true"])
            self._camera.lookat[:] = row["base_true"][:3]
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._robot.model, self._robot.data, self._options, None, self._camera, everything, self._scene
        )
        if self._stands:
            self._show(row["goal"])
        image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
        mujoco.mjr_render(self._rect, self._scene, self._gl)
        mujoco.mjr_readPixels(image, None, self._rect, self._gl)
        return image[::-1]

    def _show(self, goal: NDArray[np.float64]) -> None:
        if not np.isfinite(goal).all():
            return
        size, turn = np.full(3, GOAL_M), np.eye(3).ravel()
        place = self._scene.geoms[self._scene.ngeom]
        mujoco.mjv_initGeom(
            place, mujoco.mjtGeom.mjGEOM_SPHERE, size, goal, turn, np.array(GREEN, np.float32)
        )
        self._scene.ngeom += 1


def _caption(picture: NDArray[np.uint8], said: str, load: float) -> Image.Image:
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    colour = GREY if load <= 1 else RED
    draw.rectangle((0, HEIGHT - 42, WIDTH, HEIGHT), fill=DARK)
    draw.text((10, HEIGHT - 36), said, fill=colour, font_size=14)
    draw.rectangle(
        (10, HEIGHT - 14, 10 + round((WIDTH - 20) * min(load, LOAD_MAX) / LOAD_MAX), HEIGHT - 8), fill=colour
    )
    limit = 10 + (WIDTH - 20) / LOAD_MAX
    draw.line((limit, HEIGHT - 18, limit, HEIGHT - 4), fill=GREY)
    return image


def _context() -> Any:
    """Some OpenGL context; each way fails in its own manner where it is not installed."""
    for name in CONTEXTS:
        try:
            return importlib.import_module(f"mujoco.{name}").GLContext(WIDTH, HEIGHT)
        except Exception as e:  # noqa: BLE001
            why = e
    raise ConfigError(f"--video: needs OpenGL, found none of {', '.join(CONTEXTS)}: {why!s:.200}")
