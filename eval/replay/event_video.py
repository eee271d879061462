"""Video of an event: the true pose, and its load as a bar."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw

from deploy.backends.sim.scene import GOAL_M
from deploy.state import Mode
from eval.replay.replayer import Replay, ReplayResult
from eval.video.film import FRAME_S, write_film
from eval.video.renderer import HEIGHT, WIDTH, Image, Renderer
from robots.spec import RobotSpec

LOAD_MAX = 1.5
"""Load at the end of the bar."""
RED, GREY, DARK = (230, 70, 60), (235, 235, 235), (24, 26, 30)


class EventVideo:
    """Off-screen renderer of a recorded robot."""

    def __init__(self, spec: RobotSpec) -> None:
        """Create the OpenGL context.

        Raises:
            ConfigError: OpenGL is not available.
        """
        self._renderer, self._fixed = Renderer(spec), "floating_base" not in spec.capabilities

    def write(self, path: Path, replay: Replay, result: ReplayResult) -> None:
        """Write a film of the whole window; the bar at the bottom is the load, red above the limit.

        Raises:
            OutputError: it cannot be written.
        """
        dt = replay.spec.dt
        ticks = max(1, round(FRAME_S / dt))
        write_film(path, self._images(replay, result, ticks), ticks * dt)

    def _images(self, replay: Replay, result: ReplayResult, ticks: int) -> Iterator[Image]:
        event, dt = replay.info.event, replay.spec.dt
        # MuJoCo draws an infinite floor around the camera position of the frame before.
        self.render_row(result.rows[0])
        for begin in range(0, len(result.rows), ticks):
            row, load = result.rows[begin], float(result.load[begin : begin + ticks].max())
            t, mode = (row["tick"] - event.start) * dt, Mode(int(row["mode"])).name
            text = f"{t:+.2f} s  {mode}  {event.monitor} {event.joint or ''}  load {load:.3f}"
            yield _caption(self.render_row(row), text, load)

    def render_row(self, row: Any) -> Image:
        """Image (H, W, 3) of a recorded pose and its goal."""
        if self._fixed:
            return self._renderer.image(row["q_true"], None, row["goal"], GOAL_M)
        return self._renderer.image(row["q_true"], row["base_true"], np.full(3, np.nan), GOAL_M)


def _caption(pixels: Image, text: str, load: float) -> Image:
    image = Picture.fromarray(pixels)
    draw = ImageDraw.Draw(image)
    colour = GREY if load <= 1 else RED
    draw.rectangle((0, HEIGHT - 42, WIDTH, HEIGHT), fill=DARK)
    draw.text((10, HEIGHT - 36), text, fill=colour, font_size=14)
    draw.rectangle(
        (10, HEIGHT - 14, 10 + round((WIDTH - 20) * min(load, LOAD_MAX) / LOAD_MAX), HEIGHT - 8), fill=colour
    )
    limit = 10 + (WIDTH - 20) / LOAD_MAX
    draw.line((limit, HEIGHT - 18, limit, HEIGHT - 4), fill=GREY)
    return np.asarray(image)
