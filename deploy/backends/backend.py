"""A robot as the runtime sees it, and the backend that opens one: simulated, or on a wire."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from deploy.state import Command, Sample
from robots.arrays import Bools
from robots.draws import Draw
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.motors.gains import Gains
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime


class Robot(Protocol):
    """B robots behind one interface.

    Attributes:
        robots: B.
    """

    robots: int

    def read(self) -> Sample:
        """Return the newest packet of every sensor; never block longer than a control period.

        `Packet.t` counts from the first read on the runtime's clock, which advances by one control period with each
        write: a slot that the loop skipped does not count, so a real robot maps its time stamps at every read.
        """
        ...

    def write(self, command: Command) -> None:
        """Send one command to every robot. Where `powered` is False the drives are off and brakes hold."""
        ...

    def stop(self, ids: Bools) -> None:
        """Category 0 stop: cut power now, whatever the cause. Must work when nothing else does."""
        ...

    def close(self) -> None:
        """Release the wire. Called once, after the last command or stop."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Robots that a run or a soak asks a backend for.

    Attributes:
        spec: the robot as described by its folder.
        seeds: one for each of B robots, of everything random about a simulated one. A robot on a wire is one.
        gains: drive gains from the policy's contract; None: the drives' own.
        mode: in which drives are to follow the policy; they follow its stops by position.
        draw: parameters of simulated robots, in place of those that `seeds` would draw.
    """

    spec: RobotSpec
    seeds: Sequence[np.random.SeedSequence]
    gains: Gains | None = None
    mode: ControlMode = ControlMode.POSITION
    draw: Draw | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Abilities:
    """Abilities of the robots of a backend; a request beyond them is refused before anything is opened.

    Attributes:
        control_hz: lowest and highest control rate.
        gains: the gains of its drives can be set, which torque mode needs: its stops bring them back.
        modes: in which its drives can follow a policy.
        simulated: a drawn robot can be asked for, and be viewed.
    """

    control_hz: tuple[int, int]
    gains: bool
    modes: tuple[ControlMode, ...] = (ControlMode.POSITION,)
    simulated: bool = False


R = TypeVar("R", bound=Robot)


class Backend(ABC, Generic[R]):
    """One kind of wire. Installed as an entry point of the group `firstshift.backends`."""

    abilities: ClassVar[Abilities]

    def check(self, request: Request) -> None:
        """Refuse (ConfigError) a request whose control rate, gains or mode are beyond the abilities."""
        (low, high), hz = self.abilities.control_hz, request.spec.rates.control_hz
        if not low <= hz <= high:
            raise ConfigError(f"--backend: control_hz of the robot: found {hz}, expected {low} to {high}")
        if request.gains is not None and not self.abilities.gains:
            raise ConfigError("--backend: kp and kd of the policy's contract: found some, expected none")
        if request.mode not in self.abilities.modes:
            known = ", ".join(mode.name.lower() for mode in self.abilities.modes)
            raise ConfigError(
                f"--backend: action.mode of the policy's contract: found {request.mode.name.lower()}, expected {known}"
            )
        if request.mode is ControlMode.TORQUE and not self.abilities.gains:
            raise ConfigError(
                "--backend: action.mode of the policy's contract: found torque, expected position or velocity: in"
                " torque mode kp and kd are 0 until a stop, and its drives cannot set them"
            )

    @abstractmethod
    def open(self, request: Request) -> R:
        """Connect to the robots, drives off, after `check`.

        Any signal meanwhile raises KeyboardInterrupt: what was opened must be released then.

        Raises:
            FirstshiftError: not connected, nothing has moved.
        """

    def attach(self, robot: R, runtime: "Runtime") -> None:
        """Connect simulated surroundings to the runtime, before the first tick; a robot on a wire needs none."""

    def viewer(self, robot: R) -> Callable[[object], None]:
        """Open a window on a simulated robot; return the call that updates it."""
        raise NotImplementedError
