"""Targets of the inverse kinematics: poses and velocities of the pelvis and the feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aslip.errors import ShapeError, UnreachablePoseError
from aslip.robot.rotation import cross, quaternion_to_matrix, rotate_back

_IDENTITY = (1.0, 0.0, 0.0, 0.0)
_REST = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class BodyTarget:
    """Pose and motion of the pelvis, or of the centre of a sole, at n instants; world frame.

    For a foot, x points to the toes, y to the left and z up from the floor when the sole is level.
    """

    position: np.ndarray
    """(n, 3) origin of the body [m]."""
    orientation: np.ndarray | None = None
    """(n, 4) body to world, wxyz; level and along the world's x axis by default."""
    velocity: np.ndarray | None = None
    """(n, 3) velocity of the origin [m/s]; at rest by default."""
    angular_velocity: np.ndarray | None = None
    """(n, 3) in the world frame [rad/s]; zero by default."""


@dataclass(frozen=True)
class BodyMotion:
    """Checked `BodyTarget` without missing arrays.

    Leading axes are (n,) for one body and (n, 2) for the feet, left first.
    """

    position: np.ndarray
    orientation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray

    @classmethod
    def from_target(cls, name: str, target: BodyTarget, count: int | None = None) -> BodyMotion:
        """Check and complete a target.

        Args:
            name: name of the body in error messages.
            target: target to check.
            count: expected number of instants; any by default.

        Raises:
            ShapeError: an array has the wrong shape.
            UnreachablePoseError: an element is not finite, or a quaternion is zero.
        """
        position = _checked(f"{name}.position", target.position, count, _REST)
        count = len(position)
        return cls(
            position=position,
            orientation=_unit(
                f"{name}.orientation",
                _checked(f"{name}.orientation", target.orientation, count, _IDENTITY),
            ),
            velocity=_checked(f"{name}.velocity", target.velocity, count, _REST),
            angular_velocity=_checked(
                f"{name}.angular_velocity", target.angular_velocity, count, _REST
            ),
        )

    @staticmethod
    def stack(left: BodyMotion, right: BodyMotion) -> BodyMotion:
        """Both feet as one motion with leading axes (n, 2)."""
        pairs = zip(vars(left).values(), vars(right).values(), strict=True)
        return BodyMotion(*(np.stack(pair, axis=1) for pair in pairs))


@dataclass(frozen=True)
class FootMotion:
    """Motion of both soles relative to the pelvis, in the pelvis frame; leading axes (n, 2)."""

    position: np.ndarray
    """(n, 2, 3) [m]."""
    rotation: np.ndarray
    """(n, 2, 3, 3) sole to pelvis."""
    velocity: np.ndarray
    """(n, 2, 3) [m/s]."""
    angular_velocity: np.ndarray
    """(n, 2, 3) [rad/s]."""

    @classmethod
    def relative(cls, feet: BodyMotion, pelvis: BodyMotion) -> FootMotion:
        """Motion of the feet (n, 2) relative to the moving pelvis (n,)."""
        pelvis_to_world = quaternion_to_matrix(pelvis.orientation)[:, None]
        omega = pelvis.angular_velocity[:, None]
        offset = feet.position - pelvis.position[:, None]
        velocity = feet.velocity - pelvis.velocity[:, None] - cross(omega, offset)
        world_to_pelvis = np.swapaxes(pelvis_to_world, -1, -2)
        return cls(
            position=rotate_back(pelvis_to_world, offset),
            rotation=world_to_pelvis @ quaternion_to_matrix(feet.orientation),
            velocity=rotate_back(pelvis_to_world, velocity),
            angular_velocity=rotate_back(pelvis_to_world, feet.angular_velocity - omega),
        )

    def take(self, rows: np.ndarray | list[int]) -> FootMotion:
        """Select instants."""
        return FootMotion(*(array[rows] for array in vars(self).values()))


def _checked(
    name: str, value: np.ndarray | None, count: int | None, default: tuple[float, ...]
) -> np.ndarray:
    """(count, k) copy of a value, or its default repeated."""
    if value is None:
        return np.tile(default, (count or 0, 1))
    array = np.array(value, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != len(default) or count not in (array.shape[0], None):
        instants = "n" if count is None else count
        raise ShapeError(f"{name} must have shape ({instants}, {len(default)}), got {array.shape}")
    bad = ~np.isfinite(array).all(axis=1)
    if bad.any():
        index = int(bad.argmax())
        raise UnreachablePoseError(f"{name}[{index}] is not finite: {array[index].tolist()}")
    return array


def _unit(name: str, quaternion: np.ndarray) -> np.ndarray:
    norm = np.linalg.norm(quaternion, axis=1, keepdims=True)
    if not (norm > 0).all():
        raise UnreachablePoseError(f"{name}[{int(norm.argmin())}] is zero and not a rotation")
    return quaternion / norm
