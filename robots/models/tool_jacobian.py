"""Velocity, force and manipulability of the tool by Jacobians of the point at the origin, in scalar code.

A Jacobian column of joint j is [v; w], m/s and rad/s for each rad/s of that joint. A tool at p that the joint carries
has the velocity v + w × p. Joints that do not carry it do not count.
"""

import numpy as np

from robots.arrays import Floats, Ints
from robots.kernel import FLOAT, INT, array, inlined, kernel

Vector = tuple[float, float, float]
_JACOBIANS, _TOOL, _JOINTS, _ROWS = array(FLOAT, 3), array(FLOAT, 2), array(INT, 1), array(INT, 1)
_OUT = array(FLOAT, 2, written=True)


@inlined
def _crossed(w: Vector, p: Vector) -> Vector:
    """Return w × p."""
    return w[1] * p[2] - w[2] * p[1], w[2] * p[0] - w[0] * p[2], w[0] * p[1] - w[1] * p[0]


@kernel(_JACOBIANS, _TOOL, _JOINTS, _ROWS, array(FLOAT, 2), _OUT)
def find_velocities(
    jacobians: Floats, tool: Floats, joints: Ints, rows: Ints, qd: Floats, velocities: Floats
) -> None:
    """Find (R, 3) m/s of the tools of robots `rows` (R,) at joint speeds qd (R, n) rad/s.

    Args:
        jacobians: (B, 6, n). tool: (B, 3) m. joints: (K,) numbers of those that carry it.
        rows, qd: as said. velocities: the result.
    """
    for row in range(len(rows)):
        robot = rows[row]
        vx, vy, vz, wx, wy, wz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in joints:
            speed = qd[row, j]
            vx += jacobians[robot, 0, j] * speed
            vy += jacobians[robot, 1, j] * speed
            vz += jacobians[robot, 2, j] * speed
            wx += jacobians[robot, 3, j] * speed
            wy += jacobians[robot, 4, j] * speed
            wz += jacobians[robot, 5, j] * speed
        x, y, z = _crossed((wx, wy, wz), (tool[robot, 0], tool[robot, 1], tool[robot, 2]))
        velocities[row, 0], velocities[row, 1], velocities[row, 2] = vx + x, vy + y, vz + z


@kernel(_JACOBIANS, _TOOL, _JOINTS, array(FLOAT, 2), _OUT)
def find_torques(jacobians: Floats, tool: Floats, joints: Ints, force: Floats, torques: Floats) -> None:
    """Find (B, n) N·m, the joint torques Jᵀ[f; p × f] of a force f (B, 3) N on the tool.

    Jacobians, tool and joints are those of `find_velocities`.
    """
    for robot in range(len(jacobians)):
        f = force[robot, 0], force[robot, 1], force[robot, 2]
        moment = _crossed((tool[robot, 0], tool[robot, 1], tool[robot, 2]), f)
        torques[robot] = 0.0
        for j in joints:
            for k in range(3):
                torques[robot, j] += jacobians[robot, k, j] * f[k] + jacobians[robot, 3 + k, j] * moment[k]


@inlined
def _pivot(a: Floats, k: int) -> bool:
    """Bring the largest number of column k, from row k on, to row k; return True if its row was another one."""
    largest = k
    for i in range(k + 1, len(a)):
        if abs(a[i, k]) > abs(a[largest, k]):
            largest = i
    for j in range(k, len(a)):
        a[k, j], a[largest, j] = a[largest, j], a[k, j]
    return largest != k


@inlined
def _determinant(a: Floats) -> float:
    """Return the determinant of a matrix, which is changed: Gaussian elimination with partial pivoting.

    Source: Golub and Van Loan, Matrix Computations (4th ed., 2013), sec. 3.4.
    """
    determinant = 1.0
    for k in range(len(a)):
        determinant *= -1.0 if _pivot(a, k) else 1.0
        determinant *= a[k, k]
        if a[k, k] == 0.0:
            break
        for i in range(k + 1, len(a)):
            share = a[i, k] / a[k, k]
            for j in range(k + 1, len(a)):
                a[i, j] -= share * a[k, j]
    return determinant


@inlined
def _multiply(a: Floats, square: Floats) -> None:
    """Find the smaller of AᵀA and AAᵀ."""
    rows, columns = a.shape
    for i in range(len(square)):
        for j in range(len(square)):
            square[i, j] = 0.0
            for k in range(max(rows, columns)):
                square[i, j] += a[k, i] * a[k, j] if columns < rows else a[i, k] * a[j, k]


@kernel(_JACOBIANS, _TOOL, _JOINTS, array(FLOAT, 1, written=True))
def find_manipulability(jacobians: Floats, tool: Floats, joints: Ints, measure: Floats) -> None:
    """Find (B,) det J for six joints, √det(JᵀJ) for fewer, √det(JJᵀ) for more, with J of the tool.

    Jacobians, tool and joints are those of `find_velocities`.
    Source: Yoshikawa, Manipulability of Robotic Mechanisms (1985), eq. 4.
    """
    n, of_tool = len(joints), np.empty((6, len(joints)))
    square = np.empty((min(n, 6), min(n, 6)))
    for robot in range(len(jacobians)):
        p = tool[robot, 0], tool[robot, 1], tool[robot, 2]
        for column in range(n):
            j = joints[column]
            w = jacobians[robot, 3, j], jacobians[robot, 4, j], jacobians[robot, 5, j]
            turned = _crossed(w, p)
            for k in range(3):
                of_tool[k, column], of_tool[3 + k, column] = jacobians[robot, k, j] + turned[k], w[k]
        if n == 6:
            measure[robot] = _determinant(of_tool)
            continue
        _multiply(of_tool, square)
        measure[robot] = np.sqrt(max(_determinant(square), 0.0))
