"""What can be watched of a training: joint speeds against their limits, a window on robot 0, a film of it."""

from pathlib import Path

from deploy.operation.loop_timing import RateLimited
from eval.video.film import FRAME_S, check_film, write_film
from policies.environments.episodes import Episodes
from policies.environments.pictures import Camera, Pose, load_before_opengl, true_pose
from robots.spec import RobotSpec

VIEW_S = 1 / 30
"""s between two images of the window."""
FILM_S = 12.0


class JointSpeeds:
    """Largest joint speeds of all robots as shares of their limits, printed every so many policy steps."""

    def __init__(self, episodes: Episodes, spec: RobotSpec, steps: int) -> None:
        self._episodes, self._spec, self._every, self._steps = episodes, spec, steps, 0

    def __call__(self) -> None:
        """Count a policy step; print when it is time."""
        self._steps += 1
        if self._steps % self._every:
            return
        share = self._episodes.peak_qd.max(axis=0) / self._spec.joint_array("qd_max")
        shares = zip(self._spec.joint_names, share, strict=True)
        print("largest joint speeds, of their limits:", ", ".join(f"{name} {s:.0%}" for name, s in shares))
        self._episodes.peak_qd[:] = 0.0


class Window:
    """MuJoCo's viewer on robot 0; training does not wait for it."""

    def __init__(self, episodes: Episodes) -> None:
        """Open it.

        Raises:
            ConfigError: there is no display.
        """
        from deploy.backends.sim.view import View

        load_before_opengl()
        self._view = RateLimited(VIEW_S, View(episodes.robot).step)

    def __call__(self) -> None:
        """Show the present pose, if it is time."""
        self._view(None)


class Film:
    """Film of the first seconds of robot 0: poses are kept while it runs, and rendered afterwards."""

    def __init__(self, path: Path, spec: RobotSpec, policy_hz: int) -> None:
        """Check that a film can be made.

        Raises:
            ConfigError: unknown suffix, or OpenGL is not available.
        """
        check_film(path)
        self._path, self._camera = path, Camera(spec, "--video")
        self._every = max(1, round(FRAME_S * policy_hz))
        self._frame_s, self._steps = self._every / policy_hz, 0
        self._poses: list[Pose] = []

    def capture(self, episodes: Episodes) -> None:
        """Keep the present pose, if its image is due."""
        if self._steps % self._every == 0 and len(self._poses) * self._frame_s < FILM_S:
            self._poses.append(true_pose(episodes.robot, episodes.task, 0))
        self._steps += 1

    def write(self) -> None:
        """Render and write it.

        Raises:
            OutputError: it cannot be written.
        """
        write_film(self._path, (self._camera.image(pose) for pose in self._poses), self._frame_s)
