"""Bus that carries commands to the drives of B robots, and the drives' own answer when commands stay away.

Three things are assumed of a real bus and its drives:

- A drive without a new command keeps the last one.
- A drive without any command for `WATCHDOG_S` closes the brakes by itself. So it does for as long as its controller or
  its supply is down: springs close the brakes, and current opens them. Then it ignores commands until power has been
  off and is given again. What is down is for the caller to say: no voltage is compared here.
- Power has a wire of its own, as an STO input (IEC 61800-5-2): no fault of the bus keeps it on.

Source: Beckhoff, EL6761 documentation: the sync manager watchdog of an EtherCAT terminal trips after 100 ms by default.
Robotis, e-Manual, Bus Watchdog: a tripped servo refuses goals until the error is cleared; a reboot switches torque off.
Beckhoff, AX2000 documentation, VBUSMIN, UVLTMODE and ACTFAULT: undervoltage is a fault that inhibits the output stage.
"""

from typing import ClassVar

import numpy as np

from deploy.masks import all_true, any_true
from deploy.stage import Stage
from deploy.state import Command
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

WATCHDOG_S = 0.1
"""s without a command after which a drive closes its brakes."""
LATE_MAX_S = 0.05
"""s, the largest delay of a command."""
_JOINT_FIELDS = 6
"""q, qd, tau, kp, kd and current share of each joint, side by side."""


class CommandBus(Stage):
    """Commands on their way, and the state of the drives' watchdogs.

    Attributes:
        sent: (B, depth, 6n) commands that reached the bus, that of tick k at place k modulo depth. A lost one repeats
            the one before.
        silent: (B,) ticks since the last command arrived. enabled: (B,) drives have power and take commands.
        ready: (B,) power was off since the drives were last enabled.
        lost: (B,) the coming command is lost. late: (B,) ticks by which it is old.
        down: (B,) controller or supply is down.
    """

    carried: ClassVar[tuple[str, ...]] = ("sent", "silent", "enabled", "ready", "lost", "late", "down")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Begin without power."""
        self._n, self.depth = spec.n, 1 + round(LATE_MAX_S / spec.dt)
        course = np.zeros((self.depth, robots, _JOINT_FIELDS * spec.n))
        self.sent, self._course, self._rows = course.transpose(1, 0, 2), course, np.arange(robots)
        self.silent, self.late = np.zeros((2, robots), dtype=np.int64)
        self.enabled, self.lost, self.down = np.zeros((3, robots), dtype=bool)
        self.ready = np.ones(robots, dtype=bool)
        self._watchdog = round(WATCHDOG_S / spec.dt)

    def deliver(self, command: Command, tick: int) -> Command:
        """Return the command that drives follow in a tick; it is `powered` where drives are enabled."""
        newest, drive = self._course[tick % self.depth], command.drive
        fields = (command.q, command.qd, command.tau, drive.kp, drive.kd, command.current_share)
        np.concatenate(fields, axis=1, out=newest)
        missing = self.lost | self.down
        all_arrive = not any_true(missing)
        if all_arrive and all_true(self.enabled & command.powered):
            self.silent[:] = 0  # as below, where nothing else would change
        else:
            self._enable(command.powered, ~missing)
        if all_arrive and not any_true(self.late) and all_true(self.enabled == command.powered):
            return command
        newest[missing] = self._course[(tick - 1) % self.depth][missing]
        return self._unpacked(command, self._course[(tick - self.late) % self.depth, self._rows])

    def _enable(self, powered: Bools, arrives: Bools) -> None:
        """Enable drives when power is given and a command arrives; disable them without power or by a watchdog."""
        self.silent += 1
        self.silent[arrives] = 0
        self.ready |= ~powered
        self.enabled &= powered & ~self.down & (self.silent <= self._watchdog)
        self.enabled |= powered & self.ready & arrives
        self.ready &= ~self.enabled

    def _unpacked(self, command: Command, row: Floats) -> Command:
        q, qd, tau, kp, kd, share = np.split(row, _JOINT_FIELDS, axis=1)
        drive = command.drive._replace(kp=kp, kd=kd)
        return Command(drive, q, qd, tau, powered=self.enabled, current_share=share)

    def wait(self, robot: int) -> None:
        """Let a period pass for one robot in which nobody sends."""
        self.silent[robot] += 1
        self.enabled[robot] &= self.silent[robot] <= self._watchdog

    def repair(self, robot: int) -> None:
        """Lose and delay nothing from the next command on."""
        self.lost[robot], self.late[robot], self.down[robot] = False, 0, False
