"""What supplies each term of the observation on the robot itself."""

from collections.abc import Iterator

from deploy.policy.observation_terms import READINGS, Source
from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, failed, passed, warned
from robots.spec import INERTIAL

SUPPLY: dict[Source, str] = {
    "joint_position": "encoder and filter",
    "joint_velocity": "filter of the encoder",
    "tool_position": "encoder and nominal kinematics",
    "goal_position": "goal camera",
    "goal_from_tool": "goal camera and encoder",
    "goal_torque": "goal camera and encoder",
    "target_offset": "encoder and own target",
    "last_action": "memory",
    "base_angular_velocity": "gyro",
    "base_linear_velocity": "gyro, accelerometer and standing feet",
    "base_orientation": "gyro, accelerometer and standing feet",
    "projected_gravity": "gyro, accelerometer and standing feet",
    "velocity_command": "operator",
    "gait_phase": "clock",
}
ESTIMATED: tuple[Source, ...] = ("base_linear_velocity", "base_orientation", "projected_gravity")
"""What takes all that a base is estimated from."""
DOUBTS: dict[Source, str] = {
    "base_linear_velocity": "no sensor measures it, and what is estimated drifts wherever feet slip or fly: train with"
    " that error, or let only the critic see it",
    "base_orientation": "no sensor measures yaw, which drifts: train without it, or use projected_gravity",
}


def sources(case: Case) -> Iterator[Note]:
    """Term by term: which sensor or estimator there is for it."""
    sensors, told = case.spec.sensors, []
    for term in case.contract.observation:
        kinds = INERTIAL if term.source in ESTIMATED else (READINGS[term.source].sensor,)
        if missing := [kind for kind in kinds if kind not in sensors]:
            yield failed(
                f"{term.name} ({term.source}) needs {' and '.join(missing)}, {case.spec.name} has"
                f" {', '.join(sensors)}: add the sensor to robot.toml and to the robot, or train without the term."
            )
        elif refused := [line for line in case.misfits if line.startswith(f"observation.{term.name}.source")]:
            yield failed(f"{refused[0]}.")
        elif term.source in DOUBTS:
            yield warned(f"{term.name} ({term.source}): {DOUBTS[term.source]}.")
        told.append(f"{term.name}: {SUPPLY[term.source]}")
    yield passed("; ".join(told) + ".")
