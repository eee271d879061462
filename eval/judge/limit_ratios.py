"""Limit ratios: |value| ÷ limit of every channel in every tick, in one block that is compared with 1 at once."""

from typing import NamedTuple

import numpy as np

from eval.judge.channels import Channels
from eval.judge.counts import BINS, BINS_PER_LIMIT
from eval.judge.monitor import Monitor
from eval.judge.tick_buffer import BLOCK_TICKS
from eval.judge.tick_window import JudgedRobot, TickWindow
from robots.arrays import Floats, Ints


class RatioBlock(NamedTuple):
    """Ratios of T ticks of R robots; 0 where a channel cannot be judged.

    Attributes:
        flat: (channels × T × R,) of which the others are views.
        joints: (joint monitors, T, R × n). robots: (robot monitors, T, R).
    """

    flat: Floats
    joints: Floats
    robots: Floats

    def peak(self) -> Floats:
        """(R, C) the highest ratio of each channel."""
        monitors, _, width = self.joints.shape
        robots = self.robots.shape[2]
        joints = self.joints.max(axis=1).reshape(monitors, robots, width // robots)
        return np.concatenate((joints.swapaxes(0, 1).reshape(robots, -1), self.robots.max(axis=1).T), axis=1)


class LimitRatios:
    """Evaluation of all monitors of R robots.

    Attributes:
        robot: constants. limits: (C,) in the units of the monitors; positions are from the middle of the working range.
    """

    def __init__(self, channels: Channels, robot: JudgedRobot, robots: int) -> None:
        self._channels, self.robot, self._robots = channels, robot, robots
        self._n, self._joint_monitors = len(channels.joints), channels.joint_monitors
        self._applies = [monitor in channels.monitors for monitor in channels.catalogue]
        limits = [self._limit(*each) for each in zip(channels.catalogue, self._applies, strict=True)]
        self.limits, monitors = np.concatenate(limits), zip(channels.catalogue, limits, strict=True)
        # A difference is not divided by dt, and its limit includes the monitor's tolerance.
        scales = [1.0 / (x * robot.spec.dt**m.difference_order * (1 + m.tolerance)) for m, x in monitors]
        self._joint_scale = np.stack([np.tile(s, robots) for s in scales[: self._joint_monitors]])[:, None]
        self._robot_scale = np.array(scales[self._joint_monitors :])[:, None]
        self._allocate()

    def _limit(self, monitor: Monitor, applies: bool) -> Floats:
        """(n,) or (1,); infinite where the robot does not have the monitor."""
        limit = monitor.limit(self.robot) if applies else np.inf
        return np.full(self._n if monitor.per_joint else 1, limit, dtype=float)

    def _allocate(self) -> None:
        size = len(self.limits) * BLOCK_TICKS * self._robots
        self._ratios, self._scaled, self._bins = np.zeros(size), np.zeros(size), np.zeros(size, dtype=np.intp)
        offset = np.arange(len(self.limits), dtype=float) * BINS
        first = self._joint_monitors * self._n
        self._joint_offset = np.tile(offset[:first].reshape(-1, 1, self._n), self._robots)
        self._robot_offset = offset[first:, None, None]

    def _block(self, array: Floats, ticks: int) -> RatioBlock:
        """Views of an array as long as a full block."""
        width = self._robots * self._n
        first, flat = self._joint_monitors * ticks * width, array[: len(self.limits) * ticks * self._robots]
        return RatioBlock(
            flat=flat,
            joints=flat[:first].reshape(-1, ticks, width),
            robots=flat[first:].reshape(-1, ticks, self._robots),
        )

    def evaluate(self, window: TickWindow) -> RatioBlock:
        """Return the ratios of a window, valid until the next call."""
        block = self._block(self._ratios, len(window.now.q))
        joints = block.joints.reshape(*block.joints.shape[:2], self._robots, self._n)
        outs = (*joints, *block.robots)
        for monitor, applies, out in zip(self._channels.catalogue, self._applies, outs, strict=True):
            if applies:
                np.abs(monitor.value(window), out=out)
            else:
                out[:] = 0.0
        if not (valid := window.now.valid).all():
            joints[:, ~valid], block.robots[:, ~valid] = 0.0, 0.0
        np.multiply(block.joints, self._joint_scale, out=block.joints)
        np.multiply(block.robots, self._robot_scale, out=block.robots)
        return block

    def histogram(self, block: RatioBlock) -> Ints:
        """(C, BINS) number of ratios of a block in each bin."""
        scaled = self._block(self._scaled, block.robots.shape[1])
        np.multiply(block.flat, BINS_PER_LIMIT, out=scaled.flat)
        np.minimum(scaled.flat, BINS - 1, out=scaled.flat)
        np.add(scaled.joints, self._joint_offset, out=scaled.joints)
        np.add(scaled.robots, self._robot_offset, out=scaled.robots)
        bins = self._bins[: len(scaled.flat)]
        np.copyto(bins, scaled.flat, casting="unsafe")
        return np.bincount(bins, minlength=len(self.limits) * BINS).reshape(-1, BINS)
