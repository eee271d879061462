"""One MCAP file that Foxglove opens, written so that no disk can hold up a tick."""

import errno
import os
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

import numpy as np
from foxglove import Channel, Context, open_mcap
from foxglove.channels import JointStatesChannel, LogChannel, SceneUpdateChannel
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from foxglove.messages import (
    Color,
    JointState,
    JointStates,
    Log,
    LogLevel,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    Vector3,
)

from deploy.safety.supervisor import words
from deploy.state import Mode
from robots.spec import RobotSpec

CHUNK_BYTES = 1 << 16
"""Compressed and handed over at once: 0.1 ms of a tick."""
BACKLOG = 256
"""Chunks that may wait for the disk."""
WAIT_S = 5.0
BLUE, GREEN = Color(r=0.1, g=0.4, b=1.0, a=1.0), Color(r=0.1, g=0.8, b=0.3, a=0.4)
TOOL_M = 0.02
_NUMBERS = {"type": "array", "items": {"type": ["number", "null"]}}
STATE_SCHEMA = {
    "title": "firstshift.State",
    "type": "object",
    "properties": {
        "mode": {"type": "string"},
        "reason": {"type": "string"},
        "reached": {"type": "integer"},
        "attempted": {"type": "integer"},
        "q_target": _NUMBERS,
        "housing_c": _NUMBERS,
        "winding_c": _NUMBERS,
        "tool": _NUMBERS,
        "goal": _NUMBERS,
        "orientation": _NUMBERS,
    },
}


WHOLE = ("tick", "mode", "reason", "reached", "attempted")


def row_type(spec: RobotSpec) -> np.dtype[np.void]:
    """One tick of one robot: what `Recording.write` takes. SI units, joint vectors in the robot's order.

    `tool` and `goal` of a robot with a base are its velocities: as believed, and as asked for; `orientation` is the
    base's in the world as believed, w first.

    Whole numbers come first; all are 8 bytes wide, so that rows can be seen as plain arrays of either kind.
    """
    numbers, sent = (
        ("q", "qd", "housing_c", "winding_c", "q_target"),
        ("q_sent", "qd_sent", "qdd_sent", "tau_sent"),
    )
    return np.dtype(
        [(name, np.int64) for name in WHOLE]
        + [(name, np.float64, spec.n) for name in numbers + sent]
        + [(name, np.float64, 3) for name in ("tool", "goal")]
        + ([("orientation", np.float64, 4)] if spec.base else [])
    )


class Recording:
    """Topics /measured, /setpoint, /state, /scene (of a robot with a tool) and /log of one robot.

    What goes wrong with the disk is never raised here: `error` says what it was, and nothing is written any more.
    """

    def __init__(
        self, path: Path, spec: RobotSpec, *, start_ns: int, goal_m: float, about: Mapping[str, str]
    ) -> None:
        """Open the file, in the background.

        Args:
            path: the file, which is replaced.
            spec: the robot.
            start_ns: ns since the epoch, when tick 0 was.
            goal_m: m, how near to a goal counts.
            about: what a reader should know.
        """
        self.path, self._spec, self._start_ns, self._goal_m = path, spec, start_ns, goal_m
        # Channels fall silent when nobody holds their context any more.
        self._disk, self._context = _Disk(path), Context()
        self._measured = JointStatesChannel("/measured", context=self._context)
        self._setpoint = JointStatesChannel("/setpoint", context=self._context)
        self._scene = SceneUpdateChannel("/scene", context=self._context)
        self._log = LogChannel("/log", context=self._context)
        self._state = Channel("/state", schema=STATE_SCHEMA, context=self._context)
        options = MCAPWriteOptions(
            compression=MCAPCompression.Lz4, chunk_size=CHUNK_BYTES, disable_seeking=True
        )
        self._writer = open_mcap(self._disk, context=self._context, writer_options=options)
        self._writer.write_metadata("run", dict(about))
        self._writer.flush()

    @property
    def error(self) -> OSError | None:
        """What the disk complained of first."""
        return self._disk.error

    def settle(self) -> None:
        """Wait until everything so far is written, or failed to be."""
        self._disk.settle()

    def write(self, row: Any) -> None:
        """Record one tick, of `row_type`."""
        ns, stamp = self._time(int(row["tick"]))
        self._measured.log(self._joints(stamp, q=row["q"], qd=row["qd"]), log_time=ns)
        sent = self._joints(
            stamp, q=row["q_sent"], qd=row["qd_sent"], qdd=row["qdd_sent"], tau=row["tau_sent"]
        )
        self._setpoint.log(sent, log_time=ns)
        self._state.log(_state(row), log_time=ns)
        if self._spec.tool:
            self._scene.log(self._spheres(stamp, row), log_time=ns)

    def say(self, tick: int, message: str, *, warning: bool) -> None:
        """A line in the log."""
        ns, stamp = self._time(tick)
        level = LogLevel.Warning if warning else LogLevel.Info
        self._log.log(Log(timestamp=stamp, level=level, message=message, name=self._spec.name), log_time=ns)

    def finish(self) -> None:
        """End the file, without waiting for the disk."""
        self._writer.close()
        self._disk.end()

    def wait(self) -> None:
        """Wait a bounded time until a finished file is whole."""
        self._disk.wait()

    def _time(self, tick: int) -> tuple[int, Timestamp]:
        ns = self._start_ns + round(tick * self._spec.dt * 1e9)
        return ns, Timestamp(ns // 10**9, ns % 10**9)

    def _joints(
        self,
        stamp: Timestamp,
        *,
        q: np.ndarray,
        qd: np.ndarray,
        qdd: np.ndarray | None = None,
        tau: np.ndarray | None = None,
    ) -> JointStates:
        none = [None] * self._spec.n
        numbers = zip(
            self._spec.joint_names,
            q.tolist(),
            qd.tolist(),
            none if qdd is None else qdd.tolist(),
            none if tau is None else tau.tolist(),
            strict=True,
        )
        joints = [
            JointState(name=name, position=p, velocity=v, acceleration=a, effort=e)
            for name, p, v, a, e in numbers
        ]
        return JointStates(timestamp=stamp, joints=joints)

    def _spheres(self, stamp: Timestamp, row: Any) -> SceneUpdate:
        kinds = (("goal", 2 * self._goal_m, GREEN), ("tool", TOOL_M, BLUE))
        return SceneUpdate(entities=[_sphere(stamp, n, row[n].tolist(), size, c) for n, size, c in kinds])


def _state(row: Any) -> dict[str, object]:
    names = [
        n
        for n in ("q_target", "housing_c", "winding_c", "tool", "goal", "orientation")
        if n in row.dtype.names
    ]
    # JSON has no word for what is no number.
    numbers = {name: [x if isfinite(x) else None for x in row[name].tolist()] for name in names}
    counts = {name: int(row[name]) for name in ("reached", "attempted")}
    reason = int(row["reason"])
    return {
        "mode": Mode(int(row["mode"])).name,
        "reason": words(reason) if reason else "",
        **counts,
        **numbers,
    }


def _sphere(stamp: Timestamp, name: str, at: list[float], size: float, color: Color) -> SceneEntity:
    pose = Pose(
        position=Vector3(x=at[0], y=at[1], z=at[2]), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    ball = SpherePrimitive(pose=pose, size=Vector3(x=size, y=size, z=size), color=color)
    return SceneEntity(timestamp=stamp, frame_id="world", id=name, spheres=[ball])


class _Disk:
    """A file whose writer never waits: a thread does, and keeps the first error."""

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self._position = 0
        self._waiting: SimpleQueue[bytes | Event | None] = SimpleQueue()
        self._thread = Thread(target=self._work, args=(path,), daemon=True)
        self._thread.start()

    def write(self, data: bytes | bytearray) -> int:
        """Hand over a chunk."""
        if self._waiting.qsize() > BACKLOG:
            self.error = self.error or OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        if self.error is None:
            self._waiting.put(bytes(data))
        self._position += len(data)
        return len(data)

    def seek(self, _offset: int, _whence: int = 0) -> int:
        """Where the file is: the writer asks for nothing else."""
        return self._position

    def flush(self) -> None:
        """Every chunk is flushed as it is written."""

    def settle(self) -> None:
        """Wait for the disk."""
        reached = Event()
        self._waiting.put(reached)
        reached.wait()

    def end(self) -> None:
        """Nothing more will come."""
        self._waiting.put(None)

    def wait(self) -> None:
        """Wait for the disk to end, but not forever."""
        self._thread.join(WAIT_S)
        if self._thread.is_alive():
            self.error = self.error or OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))

    def _work(self, path: Path) -> None:
        try:
            with path.open("wb") as file:
                while (item := self._waiting.get()) is not None:
                    if isinstance(item, Event):
                        item.set()
                    else:
                        file.write(item)
                        file.flush()
        except OSError as e:
            self.error = e
            while (item := self._waiting.get()) is not None:
                if isinstance(item, Event):
                    item.set()
