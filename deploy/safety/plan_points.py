"""Points of a plan at which safety looks: a setpoint, and the stop that would begin there."""

from typing import NamedTuple

import numpy as np

from deploy.state import STOP_MOMENTS, Setpoint, Stop
from robots.arrays import Floats
from robots.kernel import FLOAT, alike, array, kernel

_Q, _QD, _QDD, _QD_PEAK, _POSE, _QD_OF_TOOL = range(6)


class PlanPoints(NamedTuple):
    """PB points, P = STOP_MOMENTS + 2, those of all robots one after another.

    Attributes:
        q: (PB, n) rad. qd: (PB, n) rad/s. qdd: (PB, n) rad/s². Of setpoints, first steps of stops, moments.
        qd_peak: (PB, n) rad/s, the speed when a stop has brought the acceleration to zero.
        poses: (PB, n) rad, of setpoints, moments, and where stops end.
        qd_of_tool: (PB, n) rad/s, of setpoints, of setpoints at their peak speed, and at moments.
    """

    q: Floats
    qd: Floats
    qdd: Floats
    qd_peak: Floats
    poses: Floats
    qd_of_tool: Floats


def plan_points(setpoint: Setpoint, stop: Stop, twice_jerk: Floats) -> PlanPoints:
    """Return the points of setpoints and their stops; `twice_jerk` (n,) rad/s³ is twice the jerk of a stop.

    Raises:
        ValueError: the stops are not those of so many robots, or have other moments.
    """
    robots, n = setpoint.q.shape
    points = np.empty((6, STOP_MOMENTS + 2, robots, n))
    shapes = {"moments": (stop.q, (STOP_MOMENTS, robots, n)), "first step": (stop.ahead.q, (robots, n))}
    for name, (found, expected) in (shapes | {"end": (stop.q_rest, (robots, n))}).items():
        if found.shape != expected:
            raise ValueError(f"stop: {name}: found shape {found.shape}, expected {expected}")
    _put(setpoint[:3], stop.ahead[:3], (stop.q, stop.qd, stop.qdd), stop.q_rest, twice_jerk, points)
    return PlanPoints(*points.reshape(6, -1, n))


Motions = tuple[Floats, Floats, Floats]


def put_points(
    setpoint: Motions, ahead: Motions, braking: Motions, q_rest: Floats, twice_jerk: Floats, points: Floats
) -> None:
    """Put setpoints, first steps and moments of stops side by side.

    A stop first brings the acceleration to zero, at its largest jerk: the speed that it gains until then is
    qdd |qdd| / (2 jerk).
    """
    moments, robots, n = braking[0].shape
    for robot in range(robots):
        for j in range(n):
            for k in range(3):
                points[k, 0, robot, j], points[k, 1, robot, j] = setpoint[k][robot, j], ahead[k][robot, j]
                for moment in range(moments):
                    points[k, 2 + moment, robot, j] = braking[k][moment, robot, j]
            for place in range(moments + 2):
                qd, qdd = points[_QD, place, robot, j], points[_QDD, place, robot, j]
                points[_QD_PEAK, place, robot, j] = qd + qdd * abs(qdd) / twice_jerk[j]
            points[_POSE, 0, robot, j] = points[_Q, 0, robot, j]
            points[_QD_OF_TOOL, 0, robot, j] = points[_QD, 0, robot, j]
            points[_QD_OF_TOOL, 1, robot, j] = points[_QD_PEAK, 0, robot, j]
            for moment in range(moments):
                points[_POSE, 1 + moment, robot, j] = points[_Q, 2 + moment, robot, j]
                points[_QD_OF_TOOL, 2 + moment, robot, j] = points[_QD, 2 + moment, robot, j]
            points[_POSE, 1 + moments, robot, j] = q_rest[robot, j]


_POINT, _MOMENTS = alike(array(FLOAT, 2), 3), alike(array(FLOAT, 3), 3)
# Not a decorator: mutation tests leave decorated functions out.
_put = kernel(_POINT, _POINT, _MOMENTS, array(FLOAT, 2), array(FLOAT, 1), array(FLOAT, 4, written=True))(
    put_points
)
