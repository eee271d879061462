"""Ground truth of a simulation, which no robot can know: for the judge and for rewards, never for the runtime."""

from typing import NamedTuple

from robots.arrays import Bools, Floats


class BaseTruth(NamedTuple):
    """True state of a floating base.

    The world is that of the model: `mounting.tilt_rad` tilts gravity in it, not the floor.

    Attributes:
        position: (B, 3) m, world. quat_wxyz: (B, 4), base in world.
        velocity: (B, 3) m/s, world. angular_velocity: (B, 3) rad/s, base frame.
        up: (B, 3) unit vector against gravity, world.
    """

    position: Floats
    quat_wxyz: Floats
    velocity: Floats
    angular_velocity: Floats
    up: Floats


class Truth(NamedTuple):
    """Ground truth at the end of a control period.

    MuJoCo's derived fields describe the state one physics step (1 ms) before `q` and `qd`.

    Attributes:
        t: s.
        q: (B, n) rad. qd: (B, n) rad/s. Of the links, behind the backlash.
        tau: (B, n) N·m, actuator torque at the joint.
        tool_position: (B, 3) m, world.
        tool_velocity: (B, 3) m/s, world, mean over the last control period.
        self_collision: (B,) any contact between links, with the table or with a touchable goal that is not allowed;
            contacts with a floor do not count.
        contact_n: (B,) N, normal force of the strongest contact, 0 where there is none; contacts of pairs that have a
            limit of their own are left out.
        winding_c, housing_c: (B, n) °C.
        valid: (B,) False from the moment the simulation of a robot diverged.
        base: of a robot with a floating base.
        allowed_contact_n: (B, P) N, normal force of the strongest contact of each allowed pair with a limit, in the
            order of robot.toml; None of a robot without such pairs.
    """

    t: float
    q: Floats
    qd: Floats
    tau: Floats
    tool_position: Floats
    tool_velocity: Floats
    self_collision: Bools
    contact_n: Floats
    winding_c: Floats
    housing_c: Floats
    valid: Bools
    base: BaseTruth | None = None
    allowed_contact_n: Floats | None = None
