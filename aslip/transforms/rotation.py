"""Batched rotations in torch: unit quaternions (*b, 4) are wxyz, vectors are (*b, 3).

An orientation maps vectors from the body frame to the world frame.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def rotate_inverse(quaternion: Tensor, vector: Tensor) -> Tensor:
    """World vectors (*b, 3), expressed in the frames of bodies with orientation `quaternion`."""
    w, u = quaternion[..., :1], -quaternion[..., 1:]
    t = 2.0 * torch.linalg.cross(u, vector)
    return vector + w * t + torch.linalg.cross(u, t)


def multiply(first: Tensor, second: Tensor) -> Tensor:
    """Product (*b, 4) of quaternions; it rotates by the second factor first."""
    w, u = first[..., :1], first[..., 1:]
    s, v = second[..., :1], second[..., 1:]
    scalar = w * s - (u * v).sum(-1, keepdim=True)
    return torch.cat([scalar, w * v + s * u + torch.linalg.cross(u.expand_as(v), v)], dim=-1)


def upper_hemisphere(quaternion: Tensor) -> Tensor:
    """Equivalent quaternions (*b, 4) with w >= 0."""
    return torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def conjugate(quaternion: Tensor) -> Tensor:
    """Inverses (*b, 4) of unit quaternions."""
    return torch.cat([quaternion[..., :1], -quaternion[..., 1:]], dim=-1)


def from_vector(rotation: Tensor) -> Tensor:
    """Unit quaternions (*b, 4) of rotation vectors (*b, 3) [rad]."""
    angle = rotation.norm(dim=-1, keepdim=True)
    vector = torch.sinc(angle / (2 * math.pi)) / 2 * rotation
    return torch.cat([(angle / 2).cos(), vector], dim=-1)


def yaw(quaternion: Tensor) -> Tensor:
    """Yaw (*b, 1) of the x axis of bodies with orientation `quaternion` (*b, 4) [rad].

    The x axis must not be vertical.
    """
    w, x, y, z = quaternion.split(1, dim=-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def yaw_quaternion(quaternion: Tensor) -> Tensor:
    """Rotation (*b, 4) about z by the `yaw` of `quaternion` (*b, 4)."""
    return vertical_quaternion(yaw(quaternion))


def heading_to_world(slope: Tensor, heading: Tensor) -> Tensor:
    """Quaternion (*b, 4), heading frame to world, from floor slope and heading (*b, 1) [rad].

    The floor is the world's xy plane; z of the heading frame is up against gravity.
    """
    tilt, turn = slope / 2, heading / 2
    cosine, sine = turn.cos(), turn.sin()
    return torch.cat(
        [
            tilt.cos() * cosine,
            tilt.sin() * sine,
            tilt.sin() * cosine,
            tilt.cos() * sine,
        ],
        dim=-1,
    )


def rotate_about_vertical(vector: Tensor, angle: Tensor) -> Tensor:
    """Vectors (*b, 3), rotated about z by angles (*b, 1) [rad]; exactly equal for zero angles."""
    x, y, z = vector.split(1, dim=-1)
    cosine, sine = angle.cos(), angle.sin()
    return torch.cat([cosine * x - sine * y, sine * x + cosine * y, z], dim=-1)


def vertical_quaternion(angle: Tensor) -> Tensor:
    """Rotations (*b, 4) about z by angles (*b, 1) [rad]."""
    half = 0.5 * angle
    zero = torch.zeros_like(half)
    return torch.cat([half.cos(), zero, zero, half.sin()], dim=-1)
