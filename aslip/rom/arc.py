"""Arcs of constant twist, the mean paths of motions, and the planar poses along them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Pose:
    """Poses on the ground of m frames in one common frame."""

    position: np.ndarray
    """(m, 3) origins of the frames [m], z = 0."""
    angle: np.ndarray
    """(m,) angles from the common x axis to the frames' x axes [rad]."""

    def rotate(self, vectors: np.ndarray) -> np.ndarray:
        """Rotate vectors (m, ..., 3) from the m frames to the common frame."""
        return rotate(vectors, self.angle)

    def transform(self, points: np.ndarray) -> np.ndarray:
        """Transform points (m, ..., 3) from the m frames to the common frame."""
        moved = self.rotate(points)
        return moved + self.position.reshape(-1, *(1,) * (moved.ndim - 2), 3)

    def inverse(self) -> Pose:
        """Poses of the common frame in each of the m frames."""
        return Pose(-rotate(self.position, -self.angle), -self.angle)


def rotate(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotate vectors (m, ..., 3) about the vertical by angles (m,)."""
    if not np.any(angle):
        return vectors
    shape = (-1, *(1,) * (vectors.ndim - 2))
    cosine, sine = np.cos(angle).reshape(shape), np.sin(angle).reshape(shape)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)


def twist_pose(command: np.ndarray, time: np.ndarray) -> Pose:
    r"""Poses at times (m,) [s] of a frame that moves at a constant twist from the origin.

    .. math::
        \mathbf c(t) = t\,\frac{\sin a}{a}\,\mathbf R(a) \begin{pmatrix} v_x \\ v_y \end{pmatrix},
        \qquad a = \tfrac12 \omega t

    Args:
        command: (c,) forward speed, sideways speed [m/s], yaw rate [rad/s]; c = 1, 2 or 3.
        time: (m,) [s], of either sign.
    """
    full = np.zeros(3)
    full[: len(command)] = command
    angle = full[2] * time
    displacement = np.outer(time, [full[0], full[1], 0.0])
    if full[2]:
        displacement = rotate(np.sinc(angle / (2 * np.pi))[:, None] * displacement, angle / 2)
    return Pose(displacement, angle)
