"""Layout of the judge's counts: channels of the monitors (listed in monitors.py) on a robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from eval.judge.monitor import Monitor
from eval.judge.monitors import MONITORS
from robots.arrays import Ints
from robots.capabilities import Capability
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec


@dataclass(frozen=True, kw_only=True)
class Channels:
    """Layout of the C channels of a robot: one for each joint of a joint monitor, one for each other monitor.

    Joint monitors come first, joints within a monitor. Every monitor of the catalogue has its channels on every robot,
    so that counts of all robots have the same columns; those that the robot does not have stay 0.

    Attributes:
        catalogue: all monitors, joint monitors first. joints: names, n of them.
        capabilities: of the robot. mode: of the policy that moves it.
    """

    catalogue: tuple[Monitor, ...]
    joints: tuple[str, ...]
    capabilities: frozenset[Capability]
    mode: ControlMode = ControlMode.POSITION

    @classmethod
    def of_robot(
        cls,
        spec: RobotSpec,
        monitors: Sequence[Monitor] = MONITORS,
        mode: ControlMode = ControlMode.POSITION,
    ) -> Self:
        """Return the channels of a robot under a policy of some mode, of monitors in any order.

        Raises:
            ConfigError: two monitors have the same name.
        """
        names = [monitor.name for monitor in monitors]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(
                    f"monitors: found {name!r} {names.count(name)} times, expected different names"
                )
        ordered = tuple(sorted(monitors, key=lambda monitor: not monitor.per_joint))
        return cls(catalogue=ordered, joints=spec.joint_names, capabilities=spec.capabilities, mode=mode)

    @cached_property
    def monitors(self) -> tuple[Monitor, ...]:
        """Monitors of the catalogue that the robot has."""
        has = (each for each in self.catalogue if each.needs <= self.capabilities)
        return tuple(monitor for monitor in has if monitor.mode in {None, self.mode})

    @cached_property
    def joint_monitors(self) -> int:
        """Number of joint monitors in the catalogue."""
        return sum(monitor.per_joint for monitor in self.catalogue)

    @cached_property
    def monitor_index(self) -> Ints:
        """(C,) place in the catalogue of each channel's monitor."""
        widths = [len(self.joints) if monitor.per_joint else 1 for monitor in self.catalogue]
        return np.repeat(np.arange(len(self.catalogue)), widths)

    @cached_property
    def _columns(self) -> dict[str, slice]:
        ends = np.cumsum(np.bincount(self.monitor_index)).tolist()
        starts = [0, *ends]
        return {m.name: slice(a, b) for m, a, b in zip(self.catalogue, starts, ends, strict=False)}

    def columns(self, monitor: str) -> slice:
        """Return the channels of a monitor."""
        return self._columns[monitor]

    def joint(self, channel: int) -> str | None:
        """Return the name of a channel's joint; None for a monitor of the whole robot."""
        n = len(self.joints)
        return self.joints[channel % n] if channel < self.joint_monitors * n else None
