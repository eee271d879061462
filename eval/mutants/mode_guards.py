"""Mutants of guards in velocity and torque mode: limits of speeds and torques, and the drives of stops."""

from dataclasses import replace

import numpy as np

from deploy.reasons import Reason
from deploy.runtime import Runtime
from eval.faults.hostile_policy import push_joints, shake
from eval.mutants.guard_removal import (
    brake_too_late,
    ignore_reasons,
    in_sequence,
    override,
    remove_second_torque_rate,
    remove_torque_bound,
    remove_torque_rate,
    scale_torque_rates,
    take_over_stiffly,
    use_full_speed,
    widen_check,
)
from eval.mutants.situation import SEED, Mutant, Situation
from robots.arrays import Floats
from robots.motors.control_mode import ControlMode

FULL_SPEED = 1.25
"""Share of the speed limit by which a torque smoother, which itself uses 0.8 of what it gets, uses all of it."""
SPEED_REASONS = Reason.VELOCITY | Reason.TOOL_SPEED
PUSHES = Situation(
    description="torque mode: full torques of random signs, 10 a second",
    policy=push_joints(0.1, SEED),
    mode="torque",
    seconds=4.0,
)


def _turn_last_joint(runtime: Runtime) -> Floats:
    """Full speed of the last joint, towards the end of its range."""
    action = np.zeros_like(runtime.action.last)
    action[:, -1] = 1.0
    return action


VELOCITY_MODE = (
    Mutant(
        guard="velocity mode: no margin of speed",
        remove_guard=use_full_speed(ControlMode.VELOCITY),
        situation=Situation(
            description="velocity mode: joints shake; speed checks off",
            policy=shake,
            prepare=ignore_reasons(SPEED_REASONS),
            mode="velocity",
            seconds=4.0,
        ),
        monitor="velocity",
    ),
    Mutant(
        guard="velocity mode: braking for an end of the range that is 1 rad beyond it",
        remove_guard=brake_too_late(1.0),
        situation=Situation(
            description="velocity mode: full speed towards the end of a range; position check off",
            policy=_turn_last_joint,
            prepare=ignore_reasons(Reason.POSITION),
            mode="velocity",
            seconds=4.0,
        ),
        monitor="position_hard",
    ),
)

TORQUE_MODE = (
    Mutant(
        guard="torque mode: no limit of the torque's rate",
        remove_guard=remove_torque_rate,
        situation=replace(
            PUSHES,
            description="torque mode: full torques of random signs, 10 a second, with accelerations of 8 rad/s²",
            prepare=in_sequence(ignore_reasons(Reason.ACCELERATION), override("smoother", _qdd_max=8.0)),
        ),
        monitor="torque_rate",
    ),
    Mutant(
        guard="torque mode: no limit of the torque's second rate",
        remove_guard=remove_second_torque_rate,
        situation=Situation(
            description="torque mode: joints shake; limit of the first rate off",
            policy=shake,
            prepare=remove_torque_rate,
            mode="torque",
            seconds=4.0,
        ),
        monitor="torque_rate",
    ),
    Mutant(
        guard="torque mode: torques are not bounded by the motion that they cause",
        remove_guard=remove_torque_bound,
        situation=Situation(
            description="torque mode: full torques of random signs, 2 a second; checks of speed and acceleration off",
            policy=push_joints(0.5, SEED),
            prepare=ignore_reasons(SPEED_REASONS | Reason.ACCELERATION),
            mode="torque",
            seconds=4.0,
        ),
        monitor="velocity",
    ),
    Mutant(
        guard="torque mode: no margin of speed",
        remove_guard=use_full_speed(ControlMode.TORQUE, FULL_SPEED),
        situation=Situation(
            description="torque mode: full torques of random signs, each for 1 s; speed checks off",
            policy=push_joints(1.0, SEED),
            prepare=ignore_reasons(SPEED_REASONS),
            mode="torque",
            seconds=4.0,
        ),
        monitor="velocity",
    ),
    Mutant(
        guard="torque mode: the change of torque to the first step of a stop is not checked",
        remove_guard=widen_check("torque_change_of_stop"),
        situation=Situation(
            description="torque mode: full torques of random signs, 4 a second; torques follow 2.8 times as fast, with"
            " accelerations of 12 rad/s²",
            policy=push_joints(0.25, SEED),
            prepare=in_sequence(
                scale_torque_rates(2.8),
                ignore_reasons(Reason.ACCELERATION | Reason.VELOCITY),
                override("smoother", _qdd_max=12.0),
            ),
            mode="torque",
            seconds=8.0,
        ),
        monitor="torque_rate",
    ),
    Mutant(
        guard="torque mode: drives of a stop are stiff at once",
        remove_guard=take_over_stiffly,
        situation=PUSHES,
        monitor="command_jump",
    ),
)
