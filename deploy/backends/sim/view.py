"""MuJoCo's viewer on a simulated robot, where there is a display."""

import atexit
import os
import sys
import threading
import warnings

import glfw
import mujoco.viewer
import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.scene import GOAL_M, Scene, add_goal
from robots.errors import ConfigError

CLOSE_S = 5.0
"""s to wait for the window's thread to end."""


class View:
    """Window on the true pose of one robot and on its visible goal; closing it ends the view, not the run.

    Attributes:
        robot: the simulation; another one of the same robot may take its place.
    """

    def __init__(self, robot: SimRobot, row: int = 0, option: str = "--view") -> None:
        """Open the window on robot `row`; an error names the `option` that asked for it.

        Raises:
            ConfigError: there is no display.
        """
        check_display(option)
        self.robot, self._row, self._scene = robot, row, Scene(robot.spec)
        before = set(threading.enumerate())
        self._viewer = mujoco.viewer.launch_passive(self._scene.model, self._scene.data)
        self._viewer.opt.geomgroup[:] = 1  # shapes for collisions, too: some robots have no others
        self._threads = set(threading.enumerate()) - before
        atexit.register(self.close)

    def step(self, _: object = None) -> None:
        """Update the window."""
        if not self._viewer.is_running():
            return
        plant, row = self.robot.plant, self._row
        base = plant.kinematics.base
        with self._viewer.lock():
            pose = None if base is None else np.concatenate((base.position[row], base.quat_wxyz[row]))
            self._scene.pose(plant.q[row], pose)
            if pose is not None:
                self._viewer.cam.lookat[:] = pose[:3]
            self._viewer.user_scn.ngeom = 0
            add_goal(self._viewer.user_scn, self.robot.goal[row], GOAL_M)
        self._viewer.sync()

    def close(self) -> None:
        """Close the window and wait for its thread: MuJoCo ends GLFW when the process exits, which must come later."""
        if self._viewer.is_running():
            self._viewer.close()
        for thread in self._threads:
            thread.join(CLOSE_S)


def has_display() -> bool:
    """Return False where there is no display, as far as the environment tells."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_display(option: str) -> None:
    """Refuse (ConfigError) an option without a display: the viewer's own thread would wait forever for it."""
    if not has_display():
        raise ConfigError(f"{option}: found neither DISPLAY nor WAYLAND_DISPLAY, expected a display")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", glfw.GLFWError)
        if not glfw.init():
            raise ConfigError(f"{option}: GLFW cannot open a window on this display")
        glfw.terminate()
