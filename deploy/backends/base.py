"""What a robot looks like to the runtime: simulated or on a bus, one or many."""

from typing import Protocol

from deploy.state import Bools, Command, Sample


class Robot(Protocol):
    """B robots behind one interface."""

    robots: int

    def read(self) -> Sample:
        """The newest packets that have arrived; never blocks longer than a control period."""
        ...

    def write(self, command: Command) -> None:
        """Send one command to every robot. Where `powered` is False the drives are off and brakes hold."""
        ...

    def stop(self, ids: Bools) -> None:
        """Category 0: cut power now, whatever the cause. Must work when nothing else does."""
        ...
