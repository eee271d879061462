"""Keys of an operator who jogs a robot."""

import math

from deploy.operation.jog import Jog
from deploy.operation.keyboard import END, Keyboard
from deploy.operation.robot_run import RobotRun
from deploy.state import Mode
from robots.spec import RobotSpec

STEP_RAD = math.radians(1.0)
"""rad for each press of a key. A key that is held repeats, and a new press begins a new step."""
POLL_S = 0.02
"""s of robot time between two looks at the keys."""
KEYS = "1-9, 0, ↑ ↓: joint   ← → or - +: move   space: stop   q: end"
CHOICES = "1234567890"
DIRECTIONS = {"left": -1.0, "-": -1.0, "right": 1.0, "+": 1.0, "=": 1.0}
NEIGHBOURS = {"up": -1, "down": 1}


class JogKeys:
    """Watcher of a run that reads keys every `POLL_S` of robot time; those of a pipe wait until the robot is armed.

    Motions are for a robot that runs: keys pressed before it does, or while it stops, do not move it later.

    Attributes:
        joint: number of the chosen joint.
    """

    def __init__(self, jog: Jog, keyboard: Keyboard, spec: RobotSpec) -> None:
        self.joint = 0
        self._jog, self._keyboard, self._names = jog, keyboard, spec.joint_names
        self._every = max(1, round(POLL_S / spec.dt))

    @property
    def title(self) -> str:
        """The chosen joint, and the keys."""
        return f"{self.joint + 1} {self._names[self.joint]}   {KEYS}"

    def __call__(self, run: RobotRun) -> None:
        """Read keys if it is time."""
        mode = Mode(int(run.runtime.supervisor.mode[0]))
        if mode != Mode.RUNNING:
            self._jog.stop()
        armed = mode > Mode.ARMING or self._keyboard.terminal
        if armed and run.runtime.ticks % self._every == 0:
            for key in self._keyboard.read():
                self._press(key, run, mode == Mode.RUNNING)

    def _press(self, key: str, run: RobotRun, running: bool) -> None:
        if key in ("q", END):
            run.end()
        elif key == " ":
            self._jog.stop()
        elif key in DIRECTIONS and running:
            self._jog.move(self.joint, DIRECTIONS[key] * STEP_RAD)
        elif key in NEIGHBOURS:
            self._choose((self.joint + NEIGHBOURS[key]) % len(self._names))
        elif key in CHOICES and CHOICES.index(key) < len(self._names):
            self._choose(CHOICES.index(key))

    def _choose(self, joint: int) -> None:
        self.joint = joint
        self._jog.stop()
