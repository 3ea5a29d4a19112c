"""Batched rotations of NumPy's arrays or torch's tensors.

Unit quaternions (..., 4) are wxyz, matrices are (..., 3, 3).
A rotation from a body to the world maps vectors from the body frame to the world frame.
"""

from __future__ import annotations

import numpy as np

from aslip.base.arrays import Array, namespace

# quaternions within this tolerance of unit length count as unit quaternions (single precision)
_ROUNDING = 1e-6


def rotate(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Matrix times vector, batched: (..., 3, 3) and (..., 3) -> (..., 3)."""
    return np.matmul(matrix, vector[..., None])[..., 0]


def rotate_back(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Transposed matrix times vector, batched: (..., 3, 3) and (..., 3) -> (..., 3)."""
    return np.matmul(vector[..., None, :], matrix)[..., 0, :]


def cross(a: Array, b: Array) -> Array:
    """Vector product over the last axis; `np.cross` spends most of its time on axis juggling."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return _joined(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def dot(a: Array, b: Array) -> Array:
    """Scalar product over the last axis."""
    return (a * b).sum(-1)


def quaternion_to_matrix(quaternion: Array) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) of any length but zero.

    Those of `scipy.spatial.transform.Rotation`, bit for bit, without its import of 0.2 s.
    """
    w, x, y, z = (quaternion[..., i] for i in range(4))
    length = namespace(quaternion).sqrt(x * x + y * y + z * z + w * w)
    w, x, y, z = w / length, x / length, y / length, z / length
    entries = _joined(
        x * x - y * y - z * z + w * w, 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), -x * x + y * y - z * z + w * w, 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), -x * x - y * y + z * z + w * w,
    )  # fmt: skip
    return entries.reshape(*quaternion.shape[:-1], 3, 3)


def matrix_to_quaternion(matrix: Array) -> Array:
    """Unit quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3).

    Built from the row of 4 q q^T with the largest diagonal entry, which is the best conditioned.
    """
    xp = namespace(matrix)
    m = xp.moveaxis(matrix, (-2, -1), (0, 1))
    x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    diagonal = (
        1 + m[0, 0] + m[1, 1] + m[2, 2],
        1 + m[0, 0] - m[1, 1] - m[2, 2],
        1 - m[0, 0] + m[1, 1] - m[2, 2],
        1 - m[0, 0] - m[1, 1] + m[2, 2],
    )
    rows = (
        _joined(diagonal[0], x, y, z),
        _joined(x, diagonal[1], xy, xz),
        _joined(y, xy, diagonal[2], yz),
        _joined(z, xz, yz, diagonal[3]),
    )
    best = _joined(*diagonal).argmax(-1)[..., None]
    row = rows[3]
    for i in range(3):
        row = xp.where(best == i, rows[i], row)
    return upper_hemisphere(row / xp.linalg.norm(row, axis=-1, keepdims=True))


def upper_hemisphere(quaternion: Array) -> Array:
    """Equivalent quaternions (..., 4) with w >= 0."""
    return namespace(quaternion).where(quaternion[..., :1] < 0, -quaternion, quaternion)


def normalize(quaternion: Array) -> Array:
    """Normalise quaternions (..., 4) to unit length and w >= 0; unit ones keep their bits."""
    xp = namespace(quaternion)
    length = xp.linalg.norm(quaternion, axis=-1, keepdims=True)
    unit = xp.where(abs(length - 1) > _ROUNDING, quaternion / length, quaternion)
    return upper_hemisphere(unit)


def rotate_inverse(quaternion: Array, vector: Array) -> Array:
    """World vectors (..., 3), expressed in the frames of bodies with orientation `quaternion`.

    `vector` is (..., 3), or one (3,) for all.
    """
    w, u = quaternion[..., :1], -quaternion[..., 1:]
    t = 2.0 * cross(u, vector)
    return vector + w * t + cross(u, t)


def yaw(quaternion: Array) -> Array:
    """Yaw (...) of the x axis of bodies with orientation `quaternion` (..., 4) [rad]."""
    xp = namespace(quaternion)
    w, x, y, z = xp.moveaxis(quaternion, -1, 0)
    return xp.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def vector_to_heading(heading: Array, vector: Array) -> Array:
    """World vectors (n, ..., 3), expressed in frames with x along headings (n,); copies."""
    shape = (-1, *[1] * (vector.ndim - 2))
    xp = namespace(vector)
    cosine, sine = xp.cos(heading).reshape(shape), xp.sin(heading).reshape(shape)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return _joined(cosine * x + sine * y, cosine * y - sine * x, z)


def orientation_to_heading(heading: Array, quaternion: Array) -> Array:
    """Orientations (n, 4), given to the world, relative to frames with x along headings (n,)."""
    xp = namespace(quaternion)
    cosine, sine = xp.cos(heading / 2), xp.sin(heading / 2)
    w, x, y, z = quaternion.T
    turned = (cosine * w + sine * z, cosine * x + sine * y, cosine * y - sine * x)
    return _joined(*turned, cosine * z - sine * w)


def _joined(*columns: Array) -> Array:
    """Stack arrays of one shape along a last axis, four times faster than `np.stack`.

    The type is that of the first one.
    """
    if not isinstance(columns[0], np.ndarray | np.generic):
        return namespace(columns[0]).stack(columns, axis=-1)
    out = np.empty((*np.shape(columns[0]), len(columns)), columns[0].dtype)
    for i, column in enumerate(columns):
        out[..., i] = column
    return out


def rotate_level(vector: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Vectors (*b, 2) along the ground, turned by angles (*b) [rad]."""
    x, y, cosine, sine = vector[..., 0], vector[..., 1], np.cos(yaw), np.sin(yaw)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
