"""One MCAP file of recorded signals, for Foxglove."""

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from foxglove import Channel, Context, open_mcap
from foxglove import messages as fg
from foxglove.channels import JointStatesChannel, LogChannel, SceneUpdateChannel
from foxglove.mcap import MCAPCompression, MCAPWriteOptions

from deploy.reasons import describe
from deploy.state import Mode
from deploy.telemetry.disk_writer import WAIT_S, DiskWriter
from deploy.telemetry.signals import recorded_signals, state_schema
from robots.spec import RobotSpec

CHUNK_BYTES = 1 << 16
"""Compressed and handed over at once: 0.1 ms of a tick."""
BLUE, GREEN = fg.Color(r=0.1, g=0.4, b=1.0, a=1.0), fg.Color(r=0.1, g=0.8, b=0.3, a=0.4)
TOOL_M = 0.02
NS_MAX = 10**9 << 32
"""Bound of a timestamp, ns since the epoch, in February 2106: a clock that is wrong must not stop a robot."""


class Recording:
    """Topics /measured, /setpoint, /state, /scene (of a robot with a tool) and /log of one robot.

    Disk errors are never raised: `error` holds the first one, and nothing more is written.
    """

    def __init__(
        self, path: Path, spec: RobotSpec, *, start_ns: int, goal_m: float, about: Mapping[str, str]
    ) -> None:
        """Open the file, in the background; `start_ns` is the time of tick 0, `goal_m` the tolerance of a goal."""
        self.path, self.spec, self._start_ns, self._goal_m = path, spec, start_ns, goal_m
        self._state_names = [signal.name for signal in recorded_signals(spec) if signal.in_state]
        # Channels fall silent when their context is no longer referenced.
        self._disk, self.context = DiskWriter(path), Context()
        self._measured = JointStatesChannel("/measured", context=self.context)
        self._setpoint = JointStatesChannel("/setpoint", context=self.context)
        self._scene = SceneUpdateChannel("/scene", context=self.context)
        self._log = LogChannel("/log", context=self.context)
        self._state = Channel("/state", schema=state_schema(), context=self.context)
        options = MCAPWriteOptions(
            compression=MCAPCompression.Lz4, chunk_size=CHUNK_BYTES, disable_seeking=True
        )
        self._writer = open_mcap(self._disk, context=self.context, writer_options=options)
        self._writer.write_metadata("run", dict(about))
        self._writer.flush()

    @property
    def error(self) -> OSError | None:
        """The first error of the disk."""
        return self._disk.error

    def settle(self) -> None:
        """Wait until everything so far is written or has failed."""
        self._disk.settle()

    def write(self, row: Any) -> None:
        """Record one tick, of `row_type`."""
        ns, stamp = self.time(int(row["tick"]))
        self._measured.log(self.joint_states(stamp, q=row["q"], qd=row["qd"]), log_time=ns)
        sent = {name: row[f"{name}_sent"] for name in ("q", "qd", "qdd", "tau")}
        self._setpoint.log(self.joint_states(stamp, **sent), log_time=ns)
        self._state.log(self._state_of(row), log_time=ns)
        if "tool" in self.spec.capabilities:
            spheres = (("goal", "goal_position", 2 * self._goal_m, GREEN), ("tool", "tool", TOOL_M, BLUE))
            entities = [
                _sphere(stamp, name, row[column].tolist(), size, color)
                for name, column, size, color in spheres
                if np.isfinite(row[column]).all()
            ]
            self._scene.log(fg.SceneUpdate(entities=entities), log_time=ns)

    def log(self, tick: int, message: str, *, warning: bool) -> None:
        """Write a line to /log."""
        ns, stamp = self.time(tick)
        level = fg.LogLevel.Warning if warning else fg.LogLevel.Info
        self._log.log(fg.Log(timestamp=stamp, level=level, message=message, name=self.spec.name), log_time=ns)

    def finish(self) -> None:
        """End the file, without waiting for the disk."""
        self._writer.close()
        self._disk.end()

    def wait(self, seconds: float = WAIT_S) -> None:
        """Wait so long until a finished file is complete."""
        self._disk.wait(seconds)

    def time(self, tick: int) -> tuple[int, fg.Timestamp]:
        """Return the time of a tick, ns since the epoch and as a timestamp."""
        ns = min(max(0, self._start_ns + round(tick * self.spec.dt * 1e9)), NS_MAX - 1)
        return ns, fg.Timestamp(ns // 10**9, ns % 10**9)

    def joint_states(
        self,
        stamp: fg.Timestamp,
        *,
        q: np.ndarray,
        qd: np.ndarray,
        qdd: np.ndarray | None = None,
        tau: np.ndarray | None = None,
    ) -> fg.JointStates:
        """Return the message of all joints; None leaves a quantity out."""
        absent = [None] * self.spec.n
        columns = [absent if x is None else x.tolist() for x in (q, qd, qdd, tau)]
        joints = [
            fg.JointState(name=name, position=p, velocity=v, acceleration=a, effort=e)
            for name, p, v, a, e in zip(self.spec.joint_names, *columns, strict=True)
        ]
        return fg.JointStates(timestamp=stamp, joints=joints)

    def _state_of(self, row: Any) -> dict[str, object]:
        # JSON has no word for a number that is not finite.
        numbers = {n: [x if isfinite(x) else None for x in row[n].tolist()] for n in self._state_names}
        counts = {name: int(row[name]) for name in ("reached", "attempted")}
        mode, reason = Mode(int(row["mode"])).name, int(row["reason"])
        return {"mode": mode, "reason": describe(reason) if reason else "", **counts, **numbers}


def _sphere(stamp: fg.Timestamp, name: str, at: list[float], size: float, color: fg.Color) -> fg.SceneEntity:
    pose = fg.Pose(
        position=fg.Vector3(x=at[0], y=at[1], z=at[2]),
        orientation=fg.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
    )
    ball = fg.SpherePrimitive(pose=pose, size=fg.Vector3(x=size, y=size, z=size), color=color)
    return fg.SceneEntity(timestamp=stamp, frame_id="world", id=name, spheres=[ball])
