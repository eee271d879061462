"""Singularity metric: manipulability of an arm from its joint axes, as MuJoCo reads them in model.xml.

Drawn robots have links of other lengths. Here all have those of model.xml, because the judge knows true angles only.
"""

import mujoco
import numpy as np

from robots.arrays import Floats
from robots.errors import ConfigError
from robots.models.mujoco_model import load_mujoco
from robots.spec import RobotSpec

_LEFT, _RIGHT = [0, 0, 0, 1, 1, 2], [1, 2, 3, 2, 3, 3]
_SIGN = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])[:, None]
"""Pairs of four columns, ordered so that the reverse order gives the other two; signs of the permutations."""


class SingularityMetric:
    """Manipulability of a chain of hinges.

    Joint axes are lines in the frame of the chain's middle link, where each depends on few angles.
    """

    def __init__(self, spec: RobotSpec) -> None:
        """Read the joint axes at angles of 0, and on which side of a singularity home is.

        Raises:
            ConfigError: the robot has other joints, such as a floating base.
        """
        model = load_mujoco(spec)
        if model.nq != spec.n:
            raise ConfigError(f"{spec.folder}: margins.singularity: expected none, robot is no fixed chain")
        data = mujoco.MjData(model)
        data.qpos[:] = 0.0
        mujoco.mj_kinematics(model, data)
        middle = self._middle = spec.n // 2
        # (3, 2, n, 1): a point of each line and its direction; then the point alone.
        self._lines = np.stack((data.xanchor.T, data.xaxis.T), axis=1)[..., None]
        self._anchor = self._lines * np.array([1.0, 0.0])[:, None, None]
        # From the middle link, joints towards the base turn the other way. First and last joint move no other line.
        outward = np.where(np.arange(spec.n) < middle, -1.0, 1.0)
        self._parts = _parts((data.xaxis * outward[:, None])[1:-1])
        home = self._jacobian(spec.joint_array("q_home")[None])
        if spec.n == 6:
            # The lines of the two middle joints never move: they are a constant factor of the determinant, which
            # leaves a 4 × 4 determinant of the others.
            self._outer = [*range(middle - 1), *range(middle + 1, 6)]
            middle_columns = np.delete(home[..., 0], self._outer, axis=1)
            self._orthogonal = np.linalg.svd(middle_columns)[0].T[2:, :, None, None]
            self._factor = np.abs(np.linalg.det(home[..., 0])) / _det4(self._outer_part(home))

    def manipulability(self, q: Floats) -> Floats:
        """(M,) √det(JᵀJ) at angles (M, n) rad, or √det(JJᵀ) for more than six joints: 0 in a singularity.

        J is of the point at which the last joint is. For six joints it is det J, which is the same for every point,
        positive at home and negative beyond a singularity.

        Source: Yoshikawa, Manipulability of Robotic Mechanisms (1985), eq. 4.
        """
        jacobian = self._jacobian(q)
        if q.shape[1] == 6:
            return np.asarray(self._factor * _det4(self._outer_part(jacobian)))
        tall = jacobian.transpose(2, 0, 1)
        wide = tall.swapaxes(1, 2)
        square = wide @ tall if q.shape[1] < 6 else tall @ wide
        return np.sqrt(np.maximum(np.linalg.det(square), 0.0))

    def _jacobian(self, q: Floats) -> Floats:
        """(6, n, M) linear and angular velocity in the frame of the middle link; for six joints at its origin."""
        rows, n = q.shape
        lines, rotations = np.repeat(self._lines, rows, axis=3), _rotations(self._parts, q.T[1:-1].copy())
        for joint in (*range(1, self._middle), *range(n - 2, self._middle - 1, -1)):
            beyond = lines[:, :, :joint] if joint < self._middle else lines[:, :, joint + 1 :]
            anchor, rotation = self._anchor[:, :, joint, None], rotations[:, :, joint - 1, None, None]
            x, y, z = beyond - anchor
            # Sums of products: the bits of a matrix product depend on the number of rows.
            np.add(rotation[:, 0] * x + rotation[:, 1] * y + rotation[:, 2] * z, anchor, out=beyond)
        point, direction = lines[:, 0], lines[:, 1]
        return np.concatenate((_cross(point if n == 6 else point - point[:, -1:], direction), direction))

    def _outer_part(self, jacobian: Floats) -> Floats:
        """(4, 4, M) columns of the outer joints, orthogonal to those of the two middle joints."""
        outer = jacobian[:, self._outer]
        return np.asarray(sum(self._orthogonal[:, k] * outer[k] for k in range(6)))


def _parts(axis: Floats) -> Floats:
    """(3, 3, 3, J, 1) parts of rotations about axes (J, 3): constant, factor of the cosine, factor of the sine.

    Source: Rodrigues' formula, as in Murray, Li and Sastry, Robotic Manipulation (1994), eq. 2.14.
    """
    along = axis[:, :, None] * axis[:, None]
    parts = np.stack((along, np.eye(3) - along, np.cross(np.eye(3), axis[:, None])))
    return np.asarray(parts.transpose(0, 2, 3, 1)[..., None])


def _rotations(parts: Floats, angle: Floats) -> Floats:
    """(3, 3, J, M) rotations by angles (J, M) rad."""
    constant, with_cos, with_sin = parts
    rotations = with_cos * np.cos(angle)
    rotations += with_sin * np.sin(angle)
    rotations += constant
    return np.asarray(rotations)


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


def _det4(a: Floats) -> Floats:
    """(M,) determinants of (4, 4, M), by Laplace's expansion along two rows."""
    upper = a[0, _LEFT] * a[1, _RIGHT] - a[0, _RIGHT] * a[1, _LEFT]
    lower = a[2, _LEFT] * a[3, _RIGHT] - a[2, _RIGHT] * a[3, _LEFT]
    return np.asarray((_SIGN * upper * lower[::-1]).sum(axis=0))
