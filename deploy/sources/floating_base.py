"""Observation sources of a floating base and its feet."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np

from deploy.estimation.floating_base.floating_base import CONTACT_N, FloatingBase
from deploy.sources import maximum
from deploy.sources.maximum import Maximum, Scale
from deploy.sources.readings import sensor_reading
from deploy.sources.source import GaitLayout, ObservationSource
from robots.arrays import Floats
from robots.capabilities import Capability
from robots.models.nominal_model import height_at_home, load_pinocchio
from robots.sensors import Kind

if TYPE_CHECKING:
    from deploy.runtime import Runtime

BASE: frozenset[Capability] = frozenset({"floating_base"})
UPRIGHT_MIN = 0.05
"""Least cosine of pitch in the rate of roll, which is infinite at a right angle: the robot has fallen long before."""


def _stage(runtime: "Runtime") -> FloatingBase:
    return cast(FloatingBase, runtime.capabilities.by_name["floating_base"])


def pitch_roll(gravity: Floats) -> Floats:
    """Return (B, 2) rad, pitch and roll of bases in which gravity has the direction (B, 3): R = Rz Ry(pitch) Rx(roll).

    Pitch is positive nose down, roll positive to the right.
    """
    x, y, z = -gravity.T
    return np.stack((np.arctan2(-x, np.hypot(y, z)), np.arctan2(y, z)), axis=1)


def pitch_roll_rate(gravity: Floats, angular_velocity: Floats) -> Floats:
    """Return (B, 2) rad/s, time derivatives of `pitch_roll` at angular velocities (B, 3) rad/s in the base.

    Source: Diebel, Representing Attitude (2006), Euler angle rates of the sequence (1, 2, 3).
    """
    x, y, z = -gravity.T
    turn_x, turn_y, turn_z = angular_velocity.T
    cos_pitch = np.maximum(np.hypot(y, z), UPRIGHT_MIN)
    sin_roll, cos_roll = y / cos_pitch, z / cos_pitch
    tan_pitch = -x / cos_pitch
    pitch = turn_y * cos_roll - turn_z * sin_roll
    roll = turn_x + tan_pitch * (turn_y * sin_roll + turn_z * cos_roll)
    return np.stack((pitch, roll), axis=1)


def _height(runtime: "Runtime") -> Floats:
    return _stage(runtime).height(runtime.sample, runtime.state)


def _height_at_home(scale: Scale) -> float:
    return height_at_home(scale.spec, load_pinocchio(scale.spec)[0])


def phase_numbers(phase: Floats, layout: GaitLayout) -> Floats:
    """Return (B, 2 L) sines and cosines of the phases (B, L) rad of L legs, in the order of a layout."""
    sines, cosines = np.sin(phase), np.cos(phase)
    if layout == "by_leg":
        return np.stack((sines, cosines), axis=2).reshape(len(phase), -1)
    return np.concatenate((sines, cosines) if layout == "sin_cos" else (cosines, sines), axis=1)


def _gait_phase(runtime: "Runtime") -> Floats:
    """(B, 2 L) numbers of the phases 2π (t / period_s + offset) for each of L offsets, t since arming."""
    contract = runtime.contract
    phase = 2.0 * np.pi / contract.period_s * runtime.spec.dt * runtime.ticks_since_arming
    phase = phase[:, None] + 2.0 * np.pi * np.array(contract.phase_offsets)
    return phase_numbers(phase, contract.gait_layout)


_IMU: tuple[Kind, ...] = ("gyro", "accelerometer")
_FILTER = "gyro, accelerometer and standing feet"
_NO_VELOCITY = (
    "no sensor measures it, and its estimate drifts wherever feet slip or fly: train with that error, or let only the"
    " critic observe it"
)
_NO_YAW = "no sensor measures yaw, which drifts: train without it, or use projected_gravity"

BASE_SOURCES: Mapping[str, ObservationSource] = {
    "base_angular_velocity": ObservationSource(
        frame="base",
        unit="rad/s",
        size=3,
        sensing="proprioceptive",
        maximum=maximum.sensor_range("gyro"),
        read=lambda runtime: runtime.base.angular_velocity,
        meaning="angular velocity: gyro without its estimated bias",
        sensors=("gyro",),
        needs=BASE,
    ),
    "base_linear_velocity": ObservationSource(
        frame="base",
        unit="m/s",
        size=3,
        sensing="proprioceptive",
        maximum=maximum.WALKING_SPEED,
        read=lambda runtime: runtime.base.velocity_in_base,
        meaning=f"velocity: {_FILTER}",
        sensors=_IMU,
        needs=BASE,
        doubt=_NO_VELOCITY,
    ),
    "base_linear_acceleration": ObservationSource(
        frame="base",
        unit="m/s²",
        size=3,
        sensing="proprioceptive",
        maximum=maximum.sensor_range("accelerometer"),
        read=lambda runtime: sensor_reading(runtime, "accelerometer"),
        meaning="acceleration minus gravity, +9.81 upwards at rest: accelerometer; 0 without reading",
        sensors=("accelerometer",),
        needs=BASE,
    ),
    "base_orientation": ObservationSource(
        frame="world",
        unit="1",
        size=4,
        sensing="proprioceptive",
        maximum=maximum.UNITY,
        read=lambda runtime: runtime.base.quat_wxyz,
        meaning=f"quaternion w, x, y, z: {_FILTER}",
        sensors=_IMU,
        needs=BASE,
        doubt=_NO_YAW,
    ),
    "projected_gravity": ObservationSource(
        frame="base",
        unit="1",
        size=3,
        sensing="proprioceptive",
        maximum=maximum.UNITY,
        read=lambda runtime: runtime.base.gravity,
        meaning=f"unit vector of gravity: {_FILTER}",
        sensors=_IMU,
        needs=BASE,
    ),
    "base_pitch_roll": ObservationSource(
        frame="world",
        unit="rad",
        size=2,
        sensing="proprioceptive",
        maximum=maximum.HALF_TURN,
        read=lambda runtime: pitch_roll(runtime.base.gravity),
        meaning=f"pitch (nose down) and roll (to the right) against gravity: {_FILTER}",
        sensors=_IMU,
        needs=BASE,
    ),
    "base_pitch_roll_rate": ObservationSource(
        frame="world",
        unit="rad/s",
        size=2,
        sensing="proprioceptive",
        maximum=maximum.sensor_range("gyro"),
        read=lambda runtime: pitch_roll_rate(runtime.base.gravity, runtime.base.angular_velocity),
        meaning=f"time derivatives of pitch and roll: {_FILTER}",
        sensors=_IMU,
        needs=BASE,
    ),
    "base_height": ObservationSource(
        frame="world",
        unit="m",
        sensing="proprioceptive",
        maximum=Maximum("that of the home pose", _height_at_home),
        read=_height,
        meaning="height of the IMU above the standing feet, above the lowest foot if none stands: encoder, contact"
        " sensors if there are any, and the estimated direction of gravity",
        sensors=("encoder", *_IMU),
        needs=BASE,
    ),
    "foot_contact": ObservationSource(
        frame="sensor",
        unit="1",
        each="foot",
        sensing="exteroceptive",
        maximum=maximum.UNITY,
        read=lambda runtime: np.asarray(sensor_reading(runtime, "contact") > CONTACT_N, dtype=float),
        meaning=f"1 where a foot's contact sensor reads more than {CONTACT_N:g} N, else 0; 0 without reading",
        sensors=("contact",),
        needs=BASE,
    ),
    "foot_force": ObservationSource(
        frame="sensor",
        unit="N",
        each="foot",
        sensing="exteroceptive",
        maximum=maximum.sensor_range("contact"),
        read=lambda runtime: sensor_reading(runtime, "contact"),
        meaning="normal force on a foot: contact sensor; 0 without reading",
        sensors=("contact",),
        needs=BASE,
    ),
    "gait_phase": ObservationSource(
        frame="clock",
        unit="1",
        size=2,
        sensing="none",
        maximum=maximum.UNITY,
        read=_gait_phase,
        meaning="sines and cosines of the phase of every leg since arming: clock; `period_s`, in turns the"
        " `phase_offsets` of the legs, and the `layout` of the numbers are fields of the contract's term",
        needs=BASE,
    ),
}
