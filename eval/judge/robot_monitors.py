"""Monitors of the whole robot: contacts, tool, base, power, observation, action; add one to `ROBOT_MONITORS`."""

import numpy as np

from eval.judge.monitor import Monitor, available, zero_unless
from eval.judge.tick_window import TickWindow
from robots.arrays import Bools, Floats

YES = 0.5
"""Limit of a flag: 0 is good, 1 is bad."""
SINGULAR = 1e-3
"""Share of the manipulability limit below which a robot counts as in a singularity, or beyond it."""
FALLING_RAD = 0.2
"""Angle by which a base falling at 3 rad/s turns while its IMU's packets are 50 ms late, and some estimation error."""
LOWEST = 10.0
"""Ratio at which a base counts as on the floor, or below it."""
FALL_NOTICED_S = 0.3
"""s until a fall is noticed, even a slow one."""


def _lowness(window: TickWindow) -> Floats:
    least = available(window.robot.spec.base).height_min_m
    return least / np.maximum(window.now.base_height, least / LOWEST)


def _norms(vectors: Floats) -> Floats:
    return np.asarray(np.sqrt(np.einsum("tbi,tbi->tb", vectors, vectors)))


def _workspace_distance(window: TickWindow) -> Floats:
    """Distance from the workspace's centre, or depth below its lowest point plus its radius if that is more, m."""
    position, space = window.now.tool_position, available(window.robot.spec.workspace)
    distance = _norms(position - np.array(space.centre))
    return np.maximum(distance, space.radius_max + space.z_min - position[:, :, 2])


def _inverse_manipulability(window: TickWindow) -> Floats:
    q, least = window.now.q, available(window.robot.limits.manipulability) * SINGULAR
    found = window.robot.singularity.manipulability(q.reshape(-1, q.shape[-1])).reshape(q.shape[:-1])
    return 1.0 / np.maximum(found, least)


def _largest_deviation(window: TickWindow) -> Floats:
    """Largest deviation of an observed number from its mean in training, in standard deviations, while running."""
    if window.robot.observed is None:
        return np.zeros(window.running.shape)
    mean, deviation = (
        np.array(values, dtype=np.float32)
        for values in (window.robot.observed.mean, window.robot.observed.deviation)
    )
    deviations = window.now.observation - mean
    deviations /= deviation
    np.abs(deviations, out=deviations)
    return zero_unless(window.running, deviations.max(axis=2))


def _ran_without_action(window: TickWindow) -> Bools:
    """True where a robot runs although the action of the tick before was not finite: it must stop by then."""
    return window.running & ~window.before.action_finite & window.before.powered


ROBOT_MONITORS = (
    Monitor(
        name="self_collision",
        unit="",
        hard=True,
        meaning="the robot touches itself or its table",
        needs=frozenset({"self_collision"}),
        limit=lambda robot: YES,
        value=lambda window: window.now.self_collision,
    ),
    Monitor(
        name="contact_force",
        unit="N",
        hard=True,
        meaning="true normal force of the strongest contact",
        limit=lambda robot: robot.limits.contact_n,
        value=lambda window: window.now.contact_n,
    ),
    Monitor(
        name="workspace",
        unit="m",
        hard=True,
        meaning="true tool position outside the workspace",
        needs=frozenset({"workspace"}),
        limit=lambda robot: available(robot.spec.workspace).radius_max,
        value=_workspace_distance,
    ),
    Monitor(
        name="singularity",
        unit="1/m³",
        hard=False,
        events_per_hour=0.1,
        meaning="1 ÷ manipulability (Yoshikawa) at the true angles; in a singularity and beyond it 1000 × its limit",
        needs=frozenset({"manipulability"}),
        limit=lambda robot: 1.0 / available(robot.limits.manipulability),
        value=_inverse_manipulability,
    ),
    Monitor(
        name="tool_speed",
        unit="m/s",
        hard=True,
        meaning="true tool speed",
        needs=frozenset({"workspace"}),
        limit=lambda robot: available(robot.spec.workspace).tool_speed_max,
        value=lambda window: _norms(window.now.tool_velocity),
    ),
    Monitor(
        name="tilt",
        unit="rad",
        hard=True,
        meaning="true tilt of the base: the robot falls, or has fallen",
        needs=frozenset({"floating_base"}),
        limit=lambda robot: available(robot.spec.base).tilt_max_rad,
        value=lambda window: window.now.tilt,
    ),
    Monitor(
        name="base_height",
        unit="1",
        hard=True,
        meaning="least height of the base as a share of its true height: the robot falls, or has fallen",
        needs=frozenset({"floating_base"}),
        limit=lambda robot: 1.0,
        value=_lowness,
    ),
    Monitor(
        name="fallen",
        unit="rad",
        hard=True,
        meaning="true tilt of the base of a robot still in operation, beyond the tilt at which a stop must begin",
        needs=frozenset({"floating_base"}),
        limit=lambda robot: available(robot.spec.base).tilt_max_rad + FALLING_RAD,
        value=lambda window: zero_unless(window.running, window.now.tilt),
    ),
    Monitor(
        name="powered_fallen",
        unit="s",
        hard=True,
        meaning="time with power after a fall, by the true tilt or height of the base",
        needs=frozenset({"floating_base"}),
        limit=lambda robot: FALL_NOTICED_S,
        value=lambda window: window.now.fallen_s,
    ),
    Monitor(
        name="robot_power",
        unit="W",
        hard=False,
        meaning="true mechanical power of all joints together",
        limit=lambda robot: robot.limits.power_w,
        value=lambda window: np.sum(window.joint_power, axis=2),
    ),
    Monitor(
        name="observation",
        unit="1",
        hard=False,
        meaning="deviation of an observed number from its mean in training, in standard deviations, in operation",
        limit=lambda robot: robot.limits.deviations if robot.observed else np.inf,
        value=_largest_deviation,
    ),
    Monitor(
        name="action_finite",
        unit="",
        hard=True,
        meaning="robot in operation one tick after an action with NaN or inf",
        limit=lambda robot: YES,
        value=_ran_without_action,
    ),
    Monitor(
        name="allowed_contact_force",
        unit="1",
        hard=True,
        meaning="true normal force of the contacts that robot.toml allows, as a share of their force_n",
        needs=frozenset({"allowed_contact"}),
        limit=lambda robot: 1.0,
        value=lambda window: window.now.allowed_contact,
    ),
)
