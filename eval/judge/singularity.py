"""How near an arm is to a singularity, from the lines about which its joints turn, as MuJoCo reads them in model.xml.

Robots are drawn with links of other lengths, and here all have those of model.xml: the judge is told true angles only.
"""

import mujoco
import numpy as np

from robots.arrays import Floats
from robots.models.mujoco_model import load_mujoco
from robots.spec import RobotSpec

_LEFT, _RIGHT = [0, 0, 0, 1, 1, 2], [1, 2, 3, 2, 3, 3]
_SIGN = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])[:, None]
"""Pairs of four columns, in an order whose reverse leaves the other two, and whether that takes an odd permutation."""


class Axes:
    """The lines of a chain of hinges, seen from the link in its middle: from there few angles move them."""

    def __init__(self, spec: RobotSpec) -> None:
        """Read where the lines are at angles of 0, and on which side of a singularity home is."""
        model = load_mujoco(spec)
        data = mujoco.MjData(model)
        data.qpos[:] = 0.0
        mujoco.mj_kinematics(model, data)
        middle = self._middle = spec.n // 2
        # (3, 2, n, 1): a point of each line and its direction; and again, without the direction.
        self._lines = np.stack((data.xanchor.T, data.xaxis.T), axis=1)[..., None]
        self._here = self._lines * np.array([1.0, 0.0])[:, None, None]
        # Seen from there, what lies towards the base turns the other way. First and last joint move no other line.
        outward = np.where(np.arange(spec.n) < middle, -1.0, 1.0)
        self._parts = _parts((data.xaxis * outward[:, None])[1:-1])
        home = self._jacobian(spec.joint_array("q_home")[None])
        if spec.n == 6:
            # The two joints beside the middle never move: what they do is a factor, and the others must do the rest.
            self._others = [*range(middle - 1), *range(middle + 1, 6)]
            still = np.delete(home[..., 0], self._others, axis=1)
            self._rest = np.linalg.svd(still)[0].T[2:, :, None, None]
            self._factor = np.abs(np.linalg.det(home[..., 0])) / _det4(self._without(home))

    def manipulability(self, q: Floats) -> Floats:
        """(M,) √det(JᵀJ) at angles (M, n) rad, or √det(JJᵀ) for more than six joints: 0 in a singularity.

        J is of the point at which the last joint is. For six joints it is det J, which is the same for every point,
        positive at home and negative beyond a singularity.

        Source: Yoshikawa, Manipulability of Robotic Mechanisms (1985), eq. 4.
        """
        jacobian = self._jacobian(q)
        if q.shape[1] == 6:
            return np.asarray(self._factor * _det4(self._without(jacobian)))
        tall = jacobian.transpose(2, 0, 1)
        wide = tall.swapaxes(1, 2)
        square = wide @ tall if q.shape[1] < 6 else tall @ wide
        return np.sqrt(np.maximum(np.linalg.det(square), 0.0))

    def _jacobian(self, q: Floats) -> Floats:
        """(6, n, M): linear and angular velocity in the frame of the middle link, of six joints at its origin."""
        rows, n = q.shape
        lines, turns = np.repeat(self._lines, rows, axis=3), _turns(self._parts, q.T[1:-1].copy())
        for joint in (*range(1, self._middle), *range(n - 2, self._middle - 1, -1)):
            beyond = lines[:, :, :joint] if joint < self._middle else lines[:, :, joint + 1 :]
            here, turn = self._here[:, :, joint, None], turns[:, :, joint - 1, None, None]
            x, y, z = beyond - here
            # Sums of products, not a matrix product, whose bits depend on how many rows there are.
            np.add(turn[:, 0] * x + turn[:, 1] * y + turn[:, 2] * z, here, out=beyond)
        point, way = lines[:, 0], lines[:, 1]
        return np.concatenate((_cross(point if n == 6 else point - point[:, -1:], way), way))

    def _without(self, jacobian: Floats) -> Floats:
        """(4, 4, M) what the other joints do beside what the two in the middle do."""
        others = jacobian[:, self._others]
        return np.asarray(sum(self._rest[:, k] * others[k] for k in range(6)))


def _parts(axis: Floats) -> Floats:
    """(3, 3, 3, J, 1) of rotations about axes (J, 3): what stays, goes with the cosine, and goes with the sine.

    Source: Rodrigues' formula, as in Murray, Li and Sastry, Robotic Manipulation (1994), eq. 2.14.
    """
    along = axis[:, :, None] * axis[:, None]
    parts = np.stack((along, np.eye(3) - along, np.cross(np.eye(3), axis[:, None])))
    return np.asarray(parts.transpose(0, 2, 3, 1)[..., None])


def _turns(parts: Floats, angle: Floats) -> Floats:
    """(3, 3, J, M) rotations by angles (J, M) rad."""
    still, with_cos, with_sin = parts
    turns = with_cos * np.cos(angle)
    turns += with_sin * np.sin(angle)
    turns += still
    return np.asarray(turns)


def _cross(a: Floats, b: Floats) -> Floats:
    """Products of vectors (3, ...)."""
    return np.stack((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


def _det4(a: Floats) -> Floats:
    """(M,) determinants of (4, 4, M), by Laplace's expansion along two rows."""
    upper = a[0, _LEFT] * a[1, _RIGHT] - a[0, _RIGHT] * a[1, _LEFT]
    lower = a[2, _LEFT] * a[3, _RIGHT] - a[2, _RIGHT] * a[3, _LEFT]
    return np.asarray((_SIGN * upper * lower[::-1]).sum(axis=0))
