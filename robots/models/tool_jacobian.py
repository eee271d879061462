"""Velocity, force and manipulability of the tool by Jacobians of the point at the origin, in scalar code.

A Jacobian column of joint j is [v; w], m/s and rad/s for each rad/s of that joint. A tool at p that the joint carries
has the velocity v + w × p. Joints that do not carry it do not count.
"""

import numpy as np

from robots.arrays import Floats, Ints
from robots.kernel import FLOAT, INT, array, inlined, kernel

_JACOBIANS, _TOOL, _JOINTS, _ROWS = array(FLOAT, 3), array(FLOAT, 2), array(INT, 1), array(INT, 1)
_OUT = array(FLOAT, 2, written=True)


@inlined
def _carried(jacobian: Floats, j: int, tool: Floats, axis: int) -> float:
    """Return one component of v + w × p of joint j."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    turned = jacobian[3 + b, j] * tool[c] - jacobian[3 + c, j] * tool[b]
    return jacobian[axis, j] + turned  # type: ignore[no-any-return]


@kernel(_JACOBIANS, _TOOL, _JOINTS, _ROWS, array(FLOAT, 2), _OUT)
def find_velocities(
    jacobians: Floats, tool: Floats, joints: Ints, rows: Ints, qd: Floats, velocities: Floats
) -> None:
    """Find (R, 3) m/s of the tools of robots `rows` (R,) at joint speeds qd (R, n) rad/s.

    Args:
        jacobians: (B, 6, n). tool: (B, 3) m. joints: those that carry it.
        rows, qd: see above. velocities: the result.
    """
    for row in range(len(rows)):
        jacobian, place = jacobians[rows[row]], tool[rows[row]]
        for axis in range(3):
            velocities[row, axis] = 0.0
            for j in joints:
                velocities[row, axis] += _carried(jacobian, j, place, axis) * qd[row, j]


@kernel(_JACOBIANS, _TOOL, _JOINTS, array(FLOAT, 2), _OUT)
def find_torques(jacobians: Floats, tool: Floats, joints: Ints, force: Floats, torques: Floats) -> None:
    """Find (B, n) N·m, the joint torques Jᵀf that equal a force f (B, 3) N on the tool; arguments as above."""
    for robot in range(len(jacobians)):
        torques[robot] = 0.0
        for j in joints:
            for axis in range(3):
                torques[robot, j] += _carried(jacobians[robot], j, tool[robot], axis) * force[robot, axis]


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


@kernel(_JACOBIANS, _TOOL, _JOINTS, array(FLOAT, 1, written=True))
def find_manipulability(jacobians: Floats, tool: Floats, joints: Ints, measure: Floats) -> None:
    """Find (B,) det J for six joints, √det(JᵀJ) for fewer, √det(JJᵀ) for more, with J of the tool; arguments as above.

    Source: Yoshikawa, Manipulability of Robotic Mechanisms (1985), eq. 4.
    """
    n = len(joints)
    of_tool, square = np.empty((6, n)), np.empty((min(n, 6), min(n, 6)))
    for robot in range(len(jacobians)):
        for column in range(n):
            j = joints[column]
            for axis in range(3):
                of_tool[axis, column] = _carried(jacobians[robot], j, tool[robot], axis)
                of_tool[3 + axis, column] = jacobians[robot, 3 + axis, j]
        for a in range(len(square)):
            for b in range(len(square)):
                if n == 6:
                    square[a, b] = of_tool[a, b]
                    continue
                square[a, b] = 0.0
                for k in range(max(n, 6)):
                    square[a, b] += of_tool[k, a] * of_tool[k, b] if n < 6 else of_tool[a, k] * of_tool[b, k]
        found = _determinant(square)
        measure[robot] = found if n == 6 else np.sqrt(max(found, 0.0))
