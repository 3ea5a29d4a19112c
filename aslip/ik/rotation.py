"""Batched rotations: unit quaternions are wxyz, arrays are (..., 4); matrices are (..., 3, 3)."""

from __future__ import annotations

import numpy as np


def rotate(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Matrix times vector, batched: (..., 3, 3) and (..., 3) -> (..., 3)."""
    return np.matmul(matrix, vector[..., None])[..., 0]


def rotate_back(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Transposed matrix times vector, batched: (..., 3, 3) and (..., 3) -> (..., 3)."""
    return np.matmul(vector[..., None, :], matrix)[..., 0, :]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Vector product over the last axis; `np.cross` spends most of its time on axis juggling."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar product over the last axis."""
    return np.sum(a * b, axis=-1)


def quaternion_to_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def shortest_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) that turn unit vectors `start` into `end` without twist."""
    quaternion = np.concatenate((1 + dot(start, end)[..., None], cross(start, end)), axis=-1)
    return quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def shortest_rotation_rate(start: np.ndarray, end: np.ndarray, end_rate: np.ndarray) -> np.ndarray:
    r"""Angular velocity of `shortest_rotation(start, end)` while `end` moves, frame of `start`.

    .. math:: \omega = b \times \dot b + \tau\,b

    The twist rate :math:`\tau` keeps the quaternion's vector part v normal to :math:`a`: with
    :math:`\dot v = (w\,\omega + \omega \times v) / 2`, it solves :math:`a \cdot \dot v = 0`.

    Args:
        start: (..., 3), unit vectors a, constant.
        end: (..., 3), unit vectors b.
        end_rate: (..., 3), their rates, normal to b [1/s].
    """
    scalar, vector = 1 + dot(start, end)[..., None], cross(start, end)

    def vector_rate_along_start(omega: np.ndarray) -> np.ndarray:
        return dot(start, scalar * omega + cross(omega, vector))

    swing = cross(end, end_rate)
    twist_rate = -vector_rate_along_start(swing) / vector_rate_along_start(end)
    return swing + twist_rate[..., None] * end
