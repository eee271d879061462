"""MuJoCo's viewer on a simulated robot, where there is a display."""

import os
import sys
import warnings

import glfw
import mujoco
import mujoco.viewer

from deploy.backends.sim.robot import SimRobot
from robots.errors import ConfigError
from robots.model_mujoco import load_mujoco


class View:
    """Shows the true pose of one robot; closing the window ends the view, not the run."""

    def __init__(self, robot: SimRobot, row: int = 0) -> None:
        """Open the window on robot `row`.

        Raises:
            ConfigError: there is no display.
        """
        _check_display()
        self._robot, self._row = robot, row
        self._model = load_mujoco(robot.spec)
        self._data = mujoco.MjData(self._model)
        self._viewer = mujoco.viewer.launch_passive(self._model, self._data)

    def step(self, _: object = None) -> None:
        """Bring the window up to date."""
        if not self._viewer.is_running():
            return
        with self._viewer.lock():
            self._data.qpos[:] = self._robot.plant.q[self._row]
            mujoco.mj_kinematics(self._model, self._data)
        self._viewer.sync()


def _check_display() -> None:
    """The viewer's own thread would wait forever for a window that cannot be opened."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ConfigError("--view: found neither DISPLAY nor WAYLAND_DISPLAY, expected a display")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", glfw.GLFWError)
        if not glfw.init():
            raise ConfigError("--view: GLFW cannot open a window on this display")
        glfw.terminate()
