"""Pictures of simulated robots: images, or a window that follows robot 0."""

import importlib
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.view import View, check_display, has_display
from deploy.operation.loop_timing import WallClock
from deploy.tasks.task import Task
from eval.video.renderer import Image, Renderer
from policies.environments.session import Session
from robots.arrays import Floats
from robots.spec import RobotSpec

OPTION = "render_mode {!r}"
"""Option that asks for pictures."""


class Pose(NamedTuple):
    """Content of a picture: joints (n,) rad, base (7,) or None where mounted, goal (3,) m and its tolerance."""

    q: Floats
    base: Floats | None
    goal: Floats
    goal_m: float


def true_pose(robot: SimRobot, task: Task, row: int) -> Pose:
    """Return the true pose of robot `row`, and its goal as a sphere of its tolerance."""
    base = robot.plant.kinematics.base
    pose = None if base is None else np.concatenate((base.position[row], base.quat_wxyz[row]))
    return Pose(robot.plant.q[row].copy(), pose, task.goal_position[row].copy(), task.criterion.tolerance)


def load_before_opengl() -> None:
    """Load triton, which torch loads when it likes: it crashes in a process in which Mesa has loaded its LLVM first."""
    with suppress(ImportError):
        importlib.import_module("triton")


class Camera:
    """Off-screen camera."""

    def __init__(self, spec: RobotSpec, option: str) -> None:
        """Create the renderer; an error names the `option` that asked for it.

        Raises:
            ConfigError: OpenGL is not available.
        """
        load_before_opengl()
        self._renderer, self._first = Renderer(spec, option), True

    def image(self, pose: Pose) -> Image:
        """Image (H, W, 3)."""
        if self._first:  # MuJoCo draws an infinite floor around the camera position of the image before
            self._first = False
            self._renderer.image(*pose)
        return self._renderer.image(*pose)

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()


class Screen:
    """Images of a session on demand, or a window on its robot 0, as its render mode says."""

    def __init__(self, session: Session) -> None:
        """Refuse a window without a display.

        Raises:
            ConfigError: there is none.
        """
        settings = session.settings
        self._session, self._mode = session, settings.render_mode
        self._camera: Camera | None = None
        self._view: View | None = None
        self._clock = WallClock(1 / settings.contract.policy_hz)
        if self._mode == "human":
            check_display(OPTION.format(self._mode))

    def update(self) -> None:
        """Show the present pose in the window, if there is one, in real time at most."""
        if self._mode != "human":
            return
        robot = self._session.episodes.robot
        if self._view is None:
            load_before_opengl()
            self._view = View(robot, 0, OPTION.format(self._mode))
        self._view.robot = robot
        self._view.step()
        self._clock.wait()

    def image(self, row: int) -> Image:
        """Image (H, W, 3) of robot `row`; ConfigError if OpenGL is not available."""
        if self._camera is None:
            self._camera = Camera(self._session.settings.spec, OPTION.format(self._mode))
        episodes = self._session.episodes
        return self._camera.image(true_pose(episodes.robot, episodes.task, row))

    def close(self) -> None:
        """Close window and renderer."""
        for picture in (self._camera, self._view):
            if picture is not None:
                picture.close()
        self._camera = self._view = None


def render_modes() -> list[str]:
    """Return the render modes that can be tried on this machine: a window needs a display."""
    return ["human", "rgb_array"] if has_display() else ["rgb_array"]
