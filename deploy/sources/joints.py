"""Observation sources of joints and motors, the same for every robot."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from deploy.sources import maximum
from deploy.sources.link_rotation import link_rotations, read_euler, read_rotation_rate
from deploy.sources.readings import sensor_reading
from deploy.sources.source import ObservationSource
from robots.arrays import Floats
from robots.motors.windings import nominal_windings

if TYPE_CHECKING:
    from deploy.runtime import Runtime

ROOM_C = 25.0
"""°C that a policy reads of a motor until its sensor has sent a reading."""


def _sin_cos(runtime: "Runtime") -> Floats:
    q = runtime.state.q
    both: Floats = np.stack((np.sin(q), np.cos(q)), axis=2)
    return both.reshape(len(q), -1)


def _torque(runtime: "Runtime", constant: Floats) -> Floats:
    return sensor_reading(runtime, "current") * constant


def _housing(runtime: "Runtime") -> Floats:
    return np.asarray(np.nan_to_num(runtime.estimator.windings.housing, nan=ROOM_C))


JOINT_SOURCES: Mapping[str, ObservationSource] = {
    "joint_position": ObservationSource(
        frame="joint",
        unit="rad",
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.JOINT_RANGE,
        read=lambda runtime: runtime.state.q,
        meaning="joint angle: encoder and filter",
    ),
    "joint_velocity": ObservationSource(
        frame="joint",
        unit="rad/s",
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.JOINT_SPEED,
        read=lambda runtime: runtime.state.qd,
        meaning="joint speed: filter of the encoder",
    ),
    "joint_sin_cos": ObservationSource(
        frame="joint",
        unit="1",
        size=2,
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.UNITY,
        read=_sin_cos,
        meaning="sine and cosine of the joint angle, without a jump at ±π: encoder and filter",
    ),
    "joint_euler": ObservationSource(
        frame="joint",
        unit="rad",
        size=3,
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.HALF_TURN,
        constants=link_rotations,
        read=read_euler,
        meaning="x, y, z of the link's rotation relative to the link before (R = Ry Rx Rz, as Godot's get_euler):"
        " encoder and nominal kinematics",
        doubt="Euler angles jump where one passes ±π or x passes ±π/2: joint_position or joint_sin_cos do not",
    ),
    "joint_rotation_rate": ObservationSource(
        frame="joint",
        unit="rad/s",
        size=3,
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.JOINT_SPEED,
        constants=link_rotations,
        read=read_rotation_rate,
        meaning="x, y, z of the link's angular velocity relative to the link before, in the link's axes: filter of the"
        " encoder, and nominal kinematics",
    ),
    "joint_torque": ObservationSource(
        frame="joint",
        unit="N·m",
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.JOINT_TORQUE,
        constants=lambda spec: nominal_windings(spec).constant,
        read=_torque,
        meaning="motor torque at the joint: motor current times the nominal torque constant; 0 without reading",
        sensors=("current",),
    ),
    "motor_current": ObservationSource(
        frame="joint",
        unit="A",
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.CURRENT,
        read=lambda runtime: sensor_reading(runtime, "current"),
        meaning="motor current; 0 without reading",
        sensors=("current",),
    ),
    "motor_temperature": ObservationSource(
        frame="joint",
        unit="degC",
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.HOUSING,
        read=_housing,
        meaning=f"motor housing, last valid reading; {ROOM_C:g} before the first one",
        sensors=("temperature",),
    ),
    "target_offset": ObservationSource(
        frame="joint",
        unit="rad",
        each="joint",
        sensing="proprioceptive",
        maximum=maximum.LEASH,
        read=lambda runtime: runtime.action.value - runtime.state.q,
        meaning="own target minus joint angle: encoder and memory",
    ),
    "last_action": ObservationSource(
        frame="joint",
        unit="1",
        each="joint",
        sensing="none",
        maximum=maximum.UNITY,
        read=lambda runtime: runtime.action.last,
        meaning="last action of the policy: memory",
    ),
}
