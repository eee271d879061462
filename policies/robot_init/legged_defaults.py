"""What robot.toml has for a robot with a free base in the place of tool and workspace."""

import re
from collections.abc import Mapping
from typing import Any

from policies.robot_init.vendor_model import Facts
from robots.models.inertial import AT_THE_IMU

FOOT = re.compile("foot|feet|sole|toe|ankle", re.IGNORECASE)
"""In the names of sites or of last bodies that stand on the ground."""
IMU = re.compile("imu", re.IGNORECASE)

BASE = {
    "feet": "sites or bodies that stand on the ground",
    "foot_m": "m; estimate",
    "slip": "m/s/√Hz; estimate",
    "angular_acceleration": "rad/s²/√Hz; estimate",
    "jerk": "m/s³/√Hz; estimate",
    "tilt_max_rad": "rad, beyond which it has fallen; estimate",
    "command_min": "m/s forwards, m/s to the left, rad/s to the left: what it may be asked for",
    "command_max": "the same",
    "command_s": "s for each command; estimate",
    "source": "where the numbers come from",
}
ESTIMATES = {
    "foot_m": 0.01,
    "slip": 0.05,
    "angular_acceleration": 20.0,
    "jerk": 200.0,
    "tilt_max_rad": 0.8,
    "command_s": 10.0,
}
MARGINS = {
    "q_target_rad": 0.02,
    "q_soft_rad": 0.01,
    "speed": 1.0,
    "tau": 1.0,
    "collision_m": 0.005,
    "tracking_rad": 1.5,
    "stale_s": 0.06,
    "lost_s": 0.12,
}
"""Soft drives stray far from where they are sent: that is what makes their torque. And who stops falls: it coasts as
long as it can."""
RATES = {"control_hz": 250, "physics_hz": 500}
PACKETS = {"rate_hz": 250, "drift_per_k": 0.0, "delay_s": 0.002, "loss": 0.001}
"""Of everything on the bus of a robot that walks; estimates, with which two of them do."""
LIMITS = {"arming_rad": 0.02}
"""On a gantry legs hang in their play."""
RESTLESS = 1000.0
"""rad²/s³, of joints on soft drives: they go where the ground lets them. Of two that walk, a humanoid's innovations are
as large as they should be at 100 to 300 and a small quadruped's at 300 to 1,000; too much costs nothing that is seen,
too little loses the joint."""
NO_TOOL = ("workspace_m", "singularity")
SENSORS = {
    "velocity": {
        "unit": "rad/s",
        "resolution": 0.001,
        "range": 60.0,
        "noise": 0.05,
        "bias": 0.0,
        "drift": 0.0,
    },
    "gyro": {
        "unit": "rad/s",
        "resolution": 0.0001,
        "range": 35.0,
        "noise": 0.01,
        "bias": 0.005,
        "drift": 0.001,
    },
    "accelerometer": {
        "unit": "m/s^2",
        "resolution": 0.001,
        "range": 160.0,
        "noise": 0.05,
        "bias": 0.05,
        "drift": 0.01,
    },
    "orientation": {
        "unit": "quat_wxyz",
        "resolution": 1e-5,
        "range": 1.1,
        "noise": 0.001,
        "bias": 0.003,
        "drift": 0.0,
    },
}
"""What legged robots carry beside encoders, and their IMUs say of up; estimates. One without it leaves it out."""


def asked(facts: Facts) -> dict[str, str]:
    """The fields of its base, each with its meaning."""
    known = ", ".join((*facts.sites, *facts.ends))
    return BASE | {"feet": f"{BASE['feet']}: {known}"}


def base(facts: Facts) -> dict[str, Any]:
    """What is known of its base, and estimates."""
    named = [name for names in (facts.sites, facts.ends) for name in names if FOOT.search(name)]
    sites = [name for name in named if name in facts.sites]
    return {**ESTIMATES, "feet": sites or named or None}


def sensors(facts: Facts, of_arms: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Those of an arm's drives, quicker, and its own; the IMU at a site called so or else at the base."""
    site = next((name for name in facts.sites if IMU.search(name)), facts.bodies[0])
    quick = {kind: {**sensor, **PACKETS} for kind, sensor in of_arms.items() if kind != "temperature"}
    own = {kind: {**numbers, **PACKETS} for kind, numbers in SENSORS.items()}
    for kind in AT_THE_IMU:
        own[kind]["sites"] = [site]
    return {**of_arms, **quick, **own}
