"""Rotations equal MuJoCo's functions."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aslip.robot.rotation import (
    matrix_to_quaternion,
    normalize,
    orientation_to_heading,
    quaternion_to_matrix,
    rotate_inverse,
    upper_hemisphere,
    vector_to_heading,
    yaw,
)


def _random_quaternions(count: int) -> np.ndarray:
    quaternions = np.random.default_rng(0).normal(size=(count, 4))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _matrices(quaternions: np.ndarray) -> np.ndarray:
    matrices = np.zeros((len(quaternions), 3, 3))
    for matrix, quaternion in zip(matrices, quaternions, strict=True):
        mujoco.mju_quat2Mat(matrix.reshape(-1), quaternion)
    return matrices


HALF_TURNS = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0], [1, 0, 0, 0]])


@pytest.mark.parametrize("quaternions", [_random_quaternions(200), HALF_TURNS], ids=["any", "half"])
def test_matrix_to_quaternion_equals_mujoco(quaternions: np.ndarray) -> None:
    matrices = _matrices(quaternions)
    found = matrix_to_quaternion(matrices)
    assert (found[:, 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-15)
    expected = np.zeros((len(quaternions), 4))
    for quaternion, matrix in zip(expected, matrices, strict=True):
        mujoco.mju_mat2Quat(quaternion, matrix.reshape(-1))
    same = np.abs((found * expected).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-14)
    np.testing.assert_allclose(_matrices(found), matrices, atol=1e-14)


def test_quaternion_to_matrix_equals_scipy_at_any_length() -> None:
    quaternions = _random_quaternions(100) * np.linspace(0.1, 3.0, 100)[:, None]
    expected = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    found = quaternion_to_matrix(quaternions.reshape(4, 25, 4)).reshape(-1, 3, 3)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found, _matrices(_random_quaternions(100)), atol=1e-14)


def test_rotate_inverse_equals_mujoco() -> None:
    quaternions = _random_quaternions(100)
    vectors = np.random.default_rng(1).normal(size=(100, 3))
    expected = np.zeros((100, 3))
    for result, quaternion, vector in zip(expected, quaternions, vectors, strict=True):
        inverse = np.zeros(4)
        mujoco.mju_negQuat(inverse, quaternion)
        mujoco.mju_rotVecQuat(result, vector, inverse)
    np.testing.assert_allclose(rotate_inverse(quaternions, vectors), expected, atol=1e-14)


def test_upper_hemisphere_is_the_same_rotation() -> None:
    quaternions = _random_quaternions(50)
    upper = upper_hemisphere(quaternions)
    assert (upper[:, 0] >= 0).all()
    assert (quaternions[:, 0] < 0).any()
    np.testing.assert_allclose(_matrices(upper), _matrices(quaternions), atol=1e-15)


def test_normalize_keeps_the_bits_of_unit_quaternions() -> None:
    unit = upper_hemisphere(_random_quaternions(20))
    np.testing.assert_array_equal(normalize(-unit), unit)
    np.testing.assert_allclose(normalize(3 * unit), unit, atol=1e-15)


def test_headings_turn_orientations_and_vectors_alike() -> None:
    """In a frame along its own yaw, a body has zero yaw; its axes transform like vectors."""
    quaternions, vectors = _random_quaternions(50), np.random.default_rng(2).normal(size=(50, 3))
    turned = orientation_to_heading(yaw(quaternions), quaternions)
    np.testing.assert_allclose(yaw(turned), 0.0, atol=1e-14)
    conjugate = quaternions * [1, -1, -1, -1]
    world = rotate_inverse(conjugate, vectors)
    expected = rotate_inverse(turned * [1, -1, -1, -1], vectors)
    np.testing.assert_allclose(vector_to_heading(yaw(quaternions), world), expected, atol=1e-14)
