"""Values of robot.toml for a robot with a floating base instead of tool and workspace."""

import re
from collections.abc import Mapping
from typing import Any

from policies.robot_init.vendor_model import VendorModel
from robots.models.nominal_model import AT_THE_IMU

FOOT = re.compile("foot|feet|sole|toe|ankle", re.IGNORECASE)
"""Pattern of the names of feet: sites or end bodies."""
IMU = re.compile("imu", re.IGNORECASE)

BASE = {
    "feet": "sites or bodies that stand on the ground",
    "foot_m": "m; estimate",
    "slip": "m/s/√Hz; estimate",
    "angular_acceleration": "rad/s²/√Hz; estimate",
    "jerk": "m/s³/√Hz; estimate",
    "tilt_max_rad": "rad, tilt that counts as a fall; estimate, three times the largest of its walk is enough",
    "height_min_m": "m, height of the IMU above the lowest foot; less counts as a fall: 0.6 to 0.8 of that at home",
    "descent_max": "m/s downwards that counts as a fall; estimate, three times that of its walk; jumping needs more",
    "command_min": "m/s forwards, m/s to the left, rad/s to the left: smallest command",
    "command_max": "the same, largest command",
    "command_s": "s, duration of each command; estimate",
    "source": "source of the numbers",
}
ESTIMATES = {"foot_m": 0.01, "slip": 0.05, "angular_acceleration": 20.0, "jerk": 200.0}
ESTIMATES |= {"tilt_max_rad": 0.8, "descent_max": 0.8, "command_s": 10.0}
MARGINS = {
    "q_target_rad": 0.11,
    "q_soft_rad": 0.1,
    "speed": 0.6,
    "tau": 0.8,
    "collision_m": 0.005,
    "tracking_rad": 1.5,
    "stale_s": 0.06,
    "lost_s": 0.12,
}
"""Joints on soft drives deviate from their setpoints, which produces their torque: tracking_rad is large. They
overshoot in speed and angle: speed is small and q_soft_rad large. A stopped robot falls: stale_s and lost_s are long.
Source: docs/attack.md, of a humanoid."""
MARGINS_COMMENT = (
    "estimates: try them with soak-attack, and whether it still walks with python -m eval.bench walk"
)
RATES = {"control_hz": 250, "physics_hz": 500}
PACKETS = {"rate_hz": 250, "drift_per_k": 0.0, "delay_s": 0.002, "loss": 0.001}
"""Bus of a walking robot; estimates, with which two robots walk."""
LIMITS = {"arming_rad": 0.02}
"""On a gantry the legs hang within their backlash."""
ACCELERATION_DENSITY = 1000.0
"""rad²/s³, process noise of joints with compliant drives, which are moved by the ground. Innovations are consistent at
100 to 300 for a humanoid and at 300 to 1,000 for a small quadruped; too large a value has no visible cost, too small a
value makes the filter lose the joint."""
ARM_MARGINS = ("workspace_m", "tool_speed", "singularity", "oscillation_hz", "velocity_mode", "torque_mode")
SENSOR_FIELDS = ("unit", "resolution", "range", "noise", "bias", "drift")
SENSORS = {
    "velocity": ("rad/s", 0.001, 60.0, 0.05, 0.0, 0.0),
    "gyro": ("rad/s", 0.0001, 35.0, 0.01, 0.005, 0.001),
    "accelerometer": ("m/s^2", 0.001, 160.0, 0.05, 0.05, 0.01),
    "orientation": ("quat_wxyz", 1e-5, 1.1, 0.001, 0.003, 0.0),
}
"""Sensors of legged robots besides encoders, including the orientation of the IMU; estimates."""


def base_descriptions(vendor: VendorModel) -> dict[str, str]:
    """Return the fields of [base] with descriptions."""
    known = ", ".join((*vendor.sites, *vendor.ends))
    return BASE | {"feet": f"{BASE['feet']}: {known}"}


def base_values(vendor: VendorModel) -> dict[str, Any]:
    """Return known and estimated values of [base]."""
    named = [name for names in (vendor.sites, vendor.ends) for name in names if FOOT.search(name)]
    sites = [name for name in named if name in vendor.sites]
    return {**ESTIMATES, "feet": sites or named or None}


def sensors(vendor: VendorModel, arm_sensors: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the sensors: those of an arm at the bus rate, and the IMU at a site named so or else at the base."""
    site = next((name for name in vendor.sites if IMU.search(name)), vendor.bodies[0])
    fast = {kind: {**sensor, **PACKETS} for kind, sensor in arm_sensors.items() if kind != "temperature"}
    own: dict[str, dict[str, Any]] = {
        kind: {**dict(zip(SENSOR_FIELDS, numbers, strict=True)), **PACKETS}
        for kind, numbers in SENSORS.items()
    }
    for kind in AT_THE_IMU:
        own[kind]["sites"] = [site]
    return {**arm_sensors, **fast, **own}
