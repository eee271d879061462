"""Bounds of the drive gains in a contract: those that the drives' own loop, the rate of setpoints and the load bear.

Drives close their loop at their own rate, for which `rates.physics_hz` stands: the one at which soaks prove it. A loop
of period T with gains kp and kd on an inertia J is stable while

    kd T / J + kp T² / (2 J) < 2

(symplectic Euler's rule; by Jury's criterion for z² − (2 − kd T / J − kp T² / J) z + 1 − kd T / J). In the play of a
gear, J is the rotor's alone: with more damping than that bears, its blows took motors to the end of their range.

A link that a load drives through the play hits its rotor. If the drive damps the rotor strongly, the motor comes to
the end of its range, too. A load τ, the torque that plans leave, gives a link of inertia I a speed of √(2 τ·play / I)
at the end of the play, and both go on with I / (I + J) of it. The damping of that must not need more than τ:

    kd √(2 τ·play·I) / (I + J) <= τ

The play is the nominal one. Gears have up to 4.6 times as much after two lives, and pushes give up to half of that
load.

Between two setpoints the joint must not swing: its natural frequency stays below a sixth of the control rate. On a
fixed base it must not swing after them either: safety looks at where joints are sent. Half of critical damping, with a
load that takes half of the tracking error, let adversaries pass limits of the workspace. What its load takes from its
margin to the end of its range, and from the clearances of tool and links, is bounded for each joint: an arm as soft
as its tracking error allowed sagged through its workspace, and a planar one was pushed past the end of its range. Of
clearances each joint has a quarter: a payload and a push bend three joints of an arm6 in the same direction, and with
half for each of them a stop low over the table ended below its workspace. For range and clearances, a motor without
the mode "torque" is as hot as it may be: without a loop around its current, the drive puts the voltage on it that a
cold winding needs, and holds less.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from deploy.policy.contract_action import ActionSpec
from robots.arrays import Floats
from robots.models.joint_inertia import JointInertia, joint_inertia
from robots.models.levers import joint_levers
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.motors.windings import nominal_windings
from robots.spec import RobotSpec

GAIN_MARGIN = 1.5
"""Factor on both gains under which the loop must still be stable: drawn drives have up to 1.2 of theirs."""
SETPOINTS_PER_SWING = 6
"""Control periods in one period of the joint on its drive."""
TRACKING_SHARE = 0.25
"""Share of the tracking error that stops a robot, at which a joint holds its load."""
RANGE_SHARE, CLEARANCE_SHARE = 0.5, 0.25
"""Shares that the load of a joint may take of the margin of its range, and of those of workspace and collision, at the
end of its lever; there, loads of several joints add up."""
DAMPING_MIN, DAMPING_MIN_OF_SPRINGS = 0.7, 0.05
"""Least damping ratio, on the largest inertia; the second on a floating base, where drives act as springs. The least of
a known policy is 0.07, at the hip of Unitree's H1."""


class Bounds(NamedTuple):
    """Bounds of a gain, (n,) each."""

    low: Floats
    high: Floats


def stiffness_bounds(spec: RobotSpec, mode: ControlMode) -> Bounds:
    """Return the bounds of kp, N·m/rad, of joints that are held, under an action in a mode.

    Within them, there is a kd within `damping_bounds`.
    """
    inertia, period = joint_inertia(spec), 1.0 / spec.rates.physics_hz
    low = _load(spec, mode) / _deflection(spec, mode)
    of_setpoints = inertia.least * (2.0 * np.pi / (SETPOINTS_PER_SWING * spec.dt)) ** 2
    per_root = 2.0 * _damping_ratio(spec) * np.sqrt(inertia.most)  # least kd is per_root √kp
    of_blow = (_damping_of_blow(spec, mode, inertia) / per_root) ** 2
    stable = _damping_of_rotor(spec, inertia)
    of_rotor = ((np.sqrt(per_root**2 + 2.0 * period * stable) - per_root) / period) ** 2
    return Bounds(low, np.minimum(of_setpoints, np.minimum(of_blow, of_rotor)))


def damping_bounds(spec: RobotSpec, mode: ControlMode, kp: Floats) -> Bounds:
    """Return the bounds of kd, N·m·s/rad, of joints with stiffness kp (n,); those with 0 hold speeds alone."""
    inertia, period = joint_inertia(spec), 1.0 / spec.rates.physics_hz
    of_speed = _load(spec, mode) / spec.joint_array("qd_max")
    low = np.where(kp > 0.0, 2.0 * _damping_ratio(spec) * np.sqrt(kp * inertia.most), of_speed)
    stable = _damping_of_rotor(spec, inertia) - kp * period / 2.0
    return Bounds(low, np.minimum(stable, _damping_of_blow(spec, mode, inertia)))


def _damping_ratio(spec: RobotSpec) -> float:
    return DAMPING_MIN if spec.base is None else DAMPING_MIN_OF_SPRINGS


def _damping_of_rotor(spec: RobotSpec, inertia: JointInertia) -> Floats:
    """Return N·m·s/rad (n,) that a rotor without stiffness bears in the play of its gear."""
    return 2.0 * inertia.rotor * spec.rates.physics_hz / GAIN_MARGIN


def _damping_of_blow(spec: RobotSpec, mode: ControlMode, inertia: JointInertia) -> Floats:
    """Return N·m·s/rad (n,) at which a link that is driven through the play of its gear takes all that plans leave."""
    load, rotor = _load(spec, mode), inertia.rotor
    link = np.clip(rotor, np.maximum(inertia.least - rotor, 0.0), inertia.most - rotor)  # the worst is I = J
    speed = np.sqrt(2.0 * load * spec.joint_array("play") * link) / (link + rotor)
    return np.asarray(np.divide(load, speed, out=np.full(spec.n, np.inf), where=speed > 0.0))


def _deflection(spec: RobotSpec, mode: ControlMode) -> Floats:
    """Return rad (n,) by which its load may move a joint away from its setpoint.

    On a floating base, clearances are checked where joints are.
    """
    margins = spec.margins.of(mode)
    of_tracking = np.full(spec.n, TRACKING_SHARE * spec.margins.tracking_rad)
    if spec.base is not None:
        return of_tracking
    room = np.full(spec.n, RANGE_SHARE * margins.q_soft_rad)
    clearances = [each for each in (margins.workspace_m, margins.collision_m) if each is not None]
    if clearances:
        room = np.minimum(room, CLEARANCE_SHARE * min(clearances) / np.maximum(joint_levers(spec), 1e-9))
    return np.asarray(np.minimum(of_tracking, room / _hot_resistance(spec)))


def _hot_resistance(spec: RobotSpec) -> Floats:
    """Return (n,) the resistance of the hottest windings over the one that their drives assume."""
    windings = nominal_windings(spec)
    hot = 1.0 + windings.alpha * (spec.motor_array("winding_max_c") - windings.reference_c)
    return np.where(spec.current_loops, 1.0, hot)


def _load(spec: RobotSpec, mode: ControlMode) -> Floats:
    """Return N·m (n,) that motions may need beyond the model's torque."""
    return (1.0 - spec.margins.of(mode).tau) * torque_max(spec)


def gain_misfits(action: ActionSpec, spec: RobotSpec) -> Iterator[str]:
    """Yield a line for each gain that a joint of the robot cannot bear: field, joint, found, expected."""
    gains, mode = action.gains, action.control_mode
    if gains is None or len(gains.kp) != spec.n:
        return
    stiffness, held = stiffness_bounds(spec, mode), gains.kp > 0.0
    yield from _outside("kp", gains.kp, np.where(held, stiffness.low, 0.0), stiffness.high, spec)
    kp = np.where(held, np.clip(gains.kp, *stiffness), 0.0)
    yield from _outside("kd", gains.kd, *damping_bounds(spec, mode, kp), spec)


def _outside(gain: str, found: Floats, low: Floats, high: Floats, spec: RobotSpec) -> Iterator[str]:
    for joint, value, least, most in zip(spec.joint_names, found, low, high, strict=True):
        if not least <= value <= most:
            why = _TOO_LARGE[gain] if value > most else _TOO_SMALL[gain]
            yield f"action.{gain}: {joint}: found {value:g}, expected {least:.6g} to {most:.6g}: {why}"


_TOO_SMALL = {
    "kp": "too soft for its load, which it would follow out of its range or clearances",
    "kd": "it would swing",
}
_TOO_LARGE = {
    "kp": "it would swing between two setpoints, or need more damping than it may have",
    "kd": "unstable at the rate of its drive, or too much torque where its link hits the play of its gear",
}
