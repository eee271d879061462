"""What a robot looks like to the runtime: simulated or on a bus, one or many."""

from typing import Protocol

from deploy.motion.drive_law import Gains
from deploy.state import Command, Sample
from robots.arrays import Bools, Floats


class Robot(Protocol):
    """B robots behind one interface.

    Attributes:
        gains: of the drives, where they have those of a policy's contract; None: their own.
    """

    robots: int
    gains: Gains | None

    def read(self) -> Sample:
        """The newest packet of every sensor; never blocks longer than a control period."""
        ...

    def show(self, goal: Floats) -> None:
        """Told on every tick where the goals are, (B, 3) m in the world; a real robot has cameras of its own."""
        ...

    def write(self, command: Command) -> None:
        """Send one command to every robot. Where `powered` is False the drives are off and brakes hold."""
        ...

    def stop(self, ids: Bools) -> None:
        """Category 0: cut power now, whatever the cause. Must work when nothing else does."""
        ...
