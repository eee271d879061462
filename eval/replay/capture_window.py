"""Recording window of all robots: estimates, commands and ground truth of every tick, and its MCAP file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from foxglove import Channel
from foxglove.channels import FrameTransformChannel, JointStatesChannel
from foxglove.messages import FrameTransform, Quaternion, Timestamp, Vector3
from numpy.typing import NDArray

from deploy.runtime import Runtime
from deploy.stage import Arrays
from deploy.telemetry.recording import Recording
from deploy.telemetry.signals import Ring, Rows, row_type
from deploy.truth import Truth
from robots.spec import RobotSpec

TRUE = ("q_true", "qd_true", "tau_true", "winding_true_c")
FLAGS = ("powered", "self_collision", "valid")
_NUMBERS = {"type": "array", "items": {"type": ["number", "null"]}}
TRUE_SCHEMA = {
    "title": "firstshift.True",
    "type": "object",
    "properties": {
        **dict.fromkeys(("winding_c", "tool", "tool_velocity"), _NUMBERS),
        **{name: {"type": "boolean"} for name in FLAGS},
    },
}


def window_type(spec: RobotSpec, goal_size: int) -> np.dtype[np.void]:
    """Return the dtype of one tick of one robot: `row_type` and ground truth; flags are 0 or 1.

    `base_true` is the position of a floating base in the world, m, and its orientation, w first.
    """
    recorded = row_type(spec, goal_size)
    true = [(name, np.float64, (spec.n,)) for name in TRUE]
    tool = [(name, np.float64, (3,)) for name in ("tool_true", "tool_velocity_true")]
    flags = [(name, np.float64) for name in FLAGS]
    base = [("base_true", np.float64, (7,))] if "floating_base" in spec.capabilities else []
    return np.dtype([*((name, recorded[name]) for name in recorded.names or ()), *true, *tool, *flags, *base])


class Window(Ring):
    """Ring buffer of the last ticks of B robots, of `window_type`."""

    def __init__(self, spec: RobotSpec, robots: int, goal_size: int, seconds: float) -> None:
        """Allocate for B robots and goals of `goal_size` numbers."""
        super().__init__(spec, robots, window_type(spec, goal_size), seconds=seconds)
        self.rows["tick"] = -1

    def record(self, runtime: Runtime, truth: Truth) -> None:
        """Append the tick that has just ended."""
        true = truth.q, truth.qd, truth.tau, truth.winding_c, truth.tool_position, truth.tool_velocity
        flags = runtime.command.powered, truth.self_collision, truth.valid
        base = () if truth.base is None else (truth.base.position, truth.base.quat_wxyz)
        self.step(runtime, (*true, *(flag[:, None] for flag in flags), *base))

    def between(self, begin: int, end: int, robot: int) -> Rows:
        """Return the rows (T,) of a robot from tick `begin` to before tick `end`, as far as they are in the buffer."""
        rows = self.rows[np.arange(begin, end) % len(self.rows), robot]
        return rows[rows["tick"] == np.arange(begin, end)]


def columns(rows: Rows) -> Arrays:
    """Return (T, ...) arrays of the signals by name."""
    return {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names or ()}


def from_columns(arrays: Mapping[str, NDArray[np.generic]], row: np.dtype[np.void]) -> Rows:
    """Return the rows, of type `row`, of arrays from `columns`."""
    rows = np.zeros(len(arrays["tick"]), dtype=row)
    for name, array in arrays.items():
        rows[name] = array
    return rows


def write_mcap(path: Path, spec: RobotSpec, rows: Rows, *, goal_m: float, about: Mapping[str, str]) -> None:
    """Write a window as MCAP; its clock starts at 0 with the robot's first tick.

    Raises:
        OSError: it cannot be written.
    """
    recording = _WindowRecording(path, spec, start_ns=0, goal_m=goal_m, about=about)
    for row in rows:
        recording.write(row)
    recording.finish()
    recording.wait()
    if recording.error is not None:
        raise recording.error


class _WindowRecording(Recording):
    """Recording with the additional topics /true, /true_state and, for a floating base, /tf."""

    def __init__(self, path: Path, spec: RobotSpec, **how: Any) -> None:
        super().__init__(path, spec, **how)
        self._true = JointStatesChannel("/true", context=self.context)
        self._true_state = Channel("/true_state", schema=TRUE_SCHEMA, context=self.context)
        self._tf = FrameTransformChannel("/tf", context=self.context)

    def write(self, row: Any) -> None:
        """Record one tick, of `window_type`."""
        super().write(row)
        ns, stamp = self.time(int(row["tick"]))
        self._true.log(
            self.joint_states(stamp, q=row["q_true"], qd=row["qd_true"], tau=row["tau_true"]), log_time=ns
        )
        flags = {name: bool(row[name]) for name in FLAGS}
        vectors = {name: _known(row[name]) for name in ("tool_true", "tool_velocity_true", "winding_true_c")}
        named = {name.replace("_true", ""): value for name, value in vectors.items()}
        self._true_state.log(flags | named, log_time=ns)
        if "floating_base" in self.spec.capabilities:
            self._tf.log(_transform(stamp, row["base_true"].tolist()), log_time=ns)


def _transform(stamp: Timestamp, base: list[float]) -> FrameTransform:
    x, y, z, qw, qx, qy, qz = base
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id="world",
        child_frame_id="base",
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )


def _known(values: NDArray[np.float64]) -> list[float | None]:
    return [x if np.isfinite(x) else None for x in values.tolist()]
