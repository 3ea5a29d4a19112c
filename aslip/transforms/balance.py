r"""Balance on both feet, from estimates: whether a robot that stood now would stay up.

A body on two planted feet is a linear pendulum. Its divergent component

.. math:: \xi = p + v / \omega,

with the level position p and velocity v of the pelvis, moves away from the point that carries the
weight, so a robot keeps its feet where they are only while :math:`\xi` is above the area between
its soles (Khadiv et al. 2020, "Walking control based on step timing adaptation").
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final, NamedTuple, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from aslip.estimation.legs import HEEL, TOE, leg_chains
from aslip.robot import CASSIE
from aslip.transforms.rotation import conjugate, rotate_inverse

PENDULUM_RATE: Final = 2.85
"""Rate omega of the pendulum [1/s], fitted to footsteps of the shipped policy after pushes; a point
mass at the height of a standing pelvis has 3.24."""

LARGEST_SHARE: Final = 0.4
"""Largest distance of the divergent component from the middle, along the line from foot to foot, as
a share of it; 0.5 is above a foot."""

LEAST_WIDTH: Final = 0.14
"""Least distance of the feet, across their direction [m]."""


class Balance(NamedTuple):
    """Balance of robots on both feet."""

    steady: Tensor
    """(*b, 1) bool, a robot stays up on its feet."""
    leans_left: Tensor
    """(*b, 1) bool, its divergent component is nearer to the left foot."""


def find_balance(estimate: Mapping[str, Tensor] | TensorDictBase) -> Balance:
    """Balance of robots, wherever their feet are: also of one that swings, if it landed there.

    The divergent component is a u + b f from the middle of the soles, with u from the right to the
    left sole and f along the toes. A robot is steady with |a| up to `LARGEST_SHARE`, |b| up to half
    the length of a sole, and feet at least `LEAST_WIDTH` apart.

    Args:
        estimate: entries (*b, k) of `Robot.estimate_sizes`, level in any frame: orientation,
            velocity [m/s], motor and joint positions [rad].
    """
    entries = {name: cast("Tensor", estimate[name]) for name in _READ}
    ends = _sole_ends(entries["motor_position"], entries["joint_position"])
    to_level = conjugate(entries["orientation"])[..., None, None, :]
    ends = rotate_inverse(to_level, ends)[..., :2]
    soles, toes = ends.mean(-2), ends[..., TOE, :] - ends[..., HEEL, :]
    along = toes.sum(-2)
    along = along / torch.linalg.vector_norm(along, dim=-1, keepdim=True)
    across = soles[..., 0, :] - soles[..., 1, :]
    component = entries["velocity"][..., :2] / PENDULUM_RATE - soles.mean(-2)
    width = _cross(along, across)
    share = _cross(along, component) / width
    forward = _cross(component, across) / width
    half_length = CASSIE.skeleton.geoms["left_foot"].size[1]
    above = (share.abs() <= LARGEST_SHARE) & (forward.abs() <= half_length)
    return Balance((width >= LEAST_WIDTH) & above, share > 0)


_READ: Final = ("orientation", "velocity", "motor_position", "joint_position")


def _cross(first: Tensor, second: Tensor) -> Tensor:
    """Vertical component (*b, 1) of the cross product of level vectors (*b, 2)."""
    (a, b), (c, d) = first.split(1, dim=-1), second.split(1, dim=-1)
    return a * d - b * c


def _sole_ends(motor_position: Tensor, joint_position: Tensor) -> Tensor:
    """Heel and toe ends (*b, 2, 2, 3) of the soles' axes, left first [m, pelvis].

    It is `LegKinematics` in PyTorch, which exporters can trace.
    """
    at = _constants(motor_position.device)
    motors = motor_position.unflatten(-1, (2, 5))
    joints = joint_position.unflatten(-1, (2, 3))
    # of the hinges of the leg's plane; the foot's angle is that of its motor
    planar = torch.cat([motors[..., 2:4], joints[..., :2], motors[..., 4:]], dim=-1)
    angle = torch.cumsum(planar + at.offset, dim=-1)
    turns = torch.stack([angle.cos(), angle.sin()], dim=-1)
    ankle = _turned(turns[..., :4, :], at.links).sum(-2, keepdim=True)
    plane = ankle + _turned(turns[..., 4:, :], at.ends)
    points = torch.cat([plane, at.depth.expand(*plane.shape[:-1], 1)], dim=-1)
    hips = motors[..., :2] - at.hip_zero
    for hinge in (2, 1, 0):
        if hinge < 2:
            turn = torch.stack([hips[..., hinge].cos(), hips[..., hinge].sin()], dim=-1)
            level = _turned(turn[..., None, :], points[..., :2])
            points = torch.cat([level, points[..., 2:]], dim=-1)
        points = points @ at.hip_frame[:, hinge].mT + at.hip_position[:, hinge, None]
    return points


def _turned(turn: Tensor, vector: Tensor) -> Tensor:
    """Plane vectors (*b, 2), rotated by angles with cosine and sine (*b, 2)."""
    (c, s), (x, y) = turn.split(1, dim=-1), vector.split(1, dim=-1)
    return torch.cat([c * x - s * y, s * x + c * y], dim=-1)


class _Constants(NamedTuple):
    """Constants of both legs, left first; see `aslip.estimation.legs`."""

    offset: Tensor
    """(2, 5) angles of the planar hinges to the previous link [rad]."""
    links: Tensor
    """(2, 4, 2) from each planar hinge to the next [m]."""
    ends: Tensor
    """(2, 2, 2) from the foot's hinge to heel and toe end of the sole [m]."""
    depth: Tensor
    """(2, 2, 1) distances of these ends from the plane [m]."""
    hip_zero: Tensor
    """(2, 2) readings of hip roll and yaw at `hip_frame` [rad]."""
    hip_frame: Tensor
    """(2, 3, 3, 3) frames of hip roll, yaw and pitch in the parent body."""
    hip_position: Tensor
    """(2, 3, 3) origins of these frames [m]."""


@cache
def _constants(place: torch.device) -> _Constants:
    chains = leg_chains(CASSIE)

    def both(name: str) -> Tensor:
        values = torch.from_numpy(np.stack([getattr(chain, name) for chain in chains]))
        values = torch.view_as_real(values) if values.is_complex() else values
        return values.float().to(place)

    values = {name: both(name) for name in _Constants._fields}
    return _Constants(**{**values, "depth": values["depth"][..., None]})
