import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robots.rotations import exp, from_up, matrix, product, skew

RNG = np.random.default_rng(0)
TURNS = np.concatenate([np.zeros((1, 3)), 1e-9 * np.eye(3), RNG.uniform(-3, 3, (60, 3))])


def by_scipy(quat_wxyz):
    return Rotation.from_quat(quat_wxyz, scalar_first=True)


def test_a_rotation_vector_becomes_its_rotation():
    expected = Rotation.from_rotvec(TURNS).as_matrix()
    np.testing.assert_allclose(by_scipy(exp(TURNS)).as_matrix(), expected, atol=1e-14)
    np.testing.assert_allclose(matrix(exp(TURNS)), expected, atol=1e-14)


def test_tiny_rotation_keeps_its_precision():
    np.testing.assert_allclose(exp(1e-9 * np.eye(3))[:, 1:], 0.5e-9 * np.eye(3), rtol=1e-15)


def test_product_applies_the_right_factor_first():
    a, b = exp(TURNS), exp(TURNS[::-1])
    np.testing.assert_allclose(
        matrix(product(a, b)), (by_scipy(a) * by_scipy(b)).as_matrix(), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.norm(product(1.01 * a, b), axis=1), 1.0, atol=1e-15)


@pytest.mark.parametrize("shape", [(5, 3), (5, 4, 3)])
def test_skew_is_the_cross_product(shape):
    a, b = RNG.normal(size=(2, *shape))
    np.testing.assert_allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)


def test_upright_aligns_up_without_yaw():
    up = RNG.normal(size=(200, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    rotation = by_scipy(from_up(up))
    np.testing.assert_allclose(rotation.apply(up), np.tile([0, 0, 1.0], (200, 1)), atol=1e-14)
    np.testing.assert_allclose(rotation.as_euler("ZYX")[:, 0], 0.0, atol=1e-12)
