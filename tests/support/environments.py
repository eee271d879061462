"""Ids of environments of robots that differ in joints, base, task and control mode."""

VARIOUS = tuple(
    f"firstshift/{name}-v0"
    for name in (
        *("arm6-reach-position", "arm6-reach-position-goal"),
        *("planar3-planar_reach-torque", "planar3-planar_reach-torque-goal"),
        *("quadruped-velocity-position", "quadruped-waypoint-position-goal"),
    )
)
