"""Observation sources: signals that a term of an observation may read, each declared once with its reader.

A source belongs to every robot, to a capability, or to a task; a contract may name those that its robot and task have.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from robots.arrays import Floats
from robots.capabilities import Capability
from robots.sensors import Kind

if TYPE_CHECKING:
    from deploy.runtime import Runtime

Frame = Literal["joint", "world", "base", "clock"]
BASE: frozenset[Capability] = frozenset({"floating_base"})
TOOL: frozenset[Capability] = frozenset({"tool"})


class ObservationSource(NamedTuple):
    """Declaration of one source.

    Attributes:
        frame, unit: of its numbers.
        size: numbers; None: one for each joint.
        read: (B, size) numbers from the runtime, after this tick's estimate.
        supply: sensors and estimators behind it, in words.
        sensors: kinds of sensors that it needs.
        needs: capabilities that it needs.
        doubt: why a policy had better do without it, in words; empty for most.
    """

    frame: Frame
    unit: str
    size: int | None
    read: "Callable[[Runtime], Floats]"
    supply: str
    sensors: tuple[Kind, ...] = ("encoder",)
    needs: frozenset[Capability] = frozenset()
    doubt: str = ""


def _gait_phase(runtime: "Runtime") -> Floats:
    """(B, 2) sine and cosine of 2π t / period_s, t since arming."""
    phase = 2.0 * np.pi / runtime.contract.period_s * runtime.spec.dt * runtime.ticks_since_arming
    return np.stack((np.sin(phase), np.cos(phase)), axis=1)


_IMU: tuple[Kind, ...] = ("gyro", "accelerometer")
_FILTER = "gyro, accelerometer and standing feet"
_NO_VELOCITY = (
    "no sensor measures it, and its estimate drifts wherever feet slip or fly: train with that error, or let only the"
    " critic observe it"
)
_NO_YAW = "no sensor measures yaw, which drifts: train without it, or use projected_gravity"

SOURCES: Mapping[str, ObservationSource] = {
    "joint_position": ObservationSource("joint", "rad", None, lambda r: r.state.q, "encoder and filter"),
    "joint_velocity": ObservationSource(
        "joint", "rad/s", None, lambda r: r.state.qd, "filter of the encoder"
    ),
    "target_offset": ObservationSource(
        "joint", "rad", None, lambda r: r.action.q - r.state.q, "encoder and own target"
    ),
    "last_action": ObservationSource("joint", "1", None, lambda r: r.action.last, "memory"),
    "tool_position": ObservationSource(
        "world", "m", 3, lambda r: r.tool.position, "encoder and nominal kinematics", needs=TOOL
    ),
    "base_angular_velocity": ObservationSource(
        "base", "rad/s", 3, lambda r: r.base.angular_velocity, "gyro", ("gyro",), BASE
    ),
    "base_linear_velocity": ObservationSource(
        "base", "m/s", 3, lambda r: r.base.velocity_in_base, _FILTER, _IMU, BASE, _NO_VELOCITY
    ),
    "base_orientation": ObservationSource(
        "world", "1", 4, lambda r: r.base.quat_wxyz, _FILTER, _IMU, BASE, _NO_YAW
    ),
    "projected_gravity": ObservationSource("base", "1", 3, lambda r: r.base.gravity, _FILTER, _IMU, BASE),
    "gait_phase": ObservationSource("clock", "1", 2, _gait_phase, "clock", needs=BASE),
}
"""Sources of robots, whatever their task. base_orientation: quat_wxyz. projected_gravity: unit vector of gravity."""
