"""Reference motion at one instant, as libraries and planners give it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from aslip.robot import SIDES

_FEET = ("foot_position", "foot_velocity", "foot_heading")
COLUMNS = (
    *("motor_position", "motor_velocity", "motor_torque"),
    *("body_position", "body_velocity", "body_heading"),
    *_FEET,
)
"""Arrays of a table that make a reference, in order."""


@dataclass(frozen=True)
class Reference:
    """Reference motion at one instant, in the moving frame; batch shape b.

    Moving frame: its origin goes along the mean path on the ground, at the commanded speeds along
    its own axes x and y; x points along the mean heading, y left, z up, and the frame turns at the
    commanded yaw rate. On a straight path its axes stay those of the walk.

    Velocities are over ground, expressed in the axes of the frame, so that a foot in stance has
    zero velocity. Body and feet are the reduced-order model's. The body is mapped to the pelvis
    origin, a foot to the centre of the sole.
    """

    motor_position: Tensor
    """(*b, 10) motor angles of the inverse kinematics [rad]."""
    motor_velocity: Tensor
    """(*b, 10) motor velocities [rad/s]."""
    motor_torque: Tensor
    """(*b, 10) feedforward joint torques, see `aslip.library.tabulate` [N m]."""
    body_position: Tensor
    """(*b, 3) position in the moving frame: forward and sideways deviation from the mean path,
    height above ground [m]. Public code lets x grow over a stride and jump back to 0; we subtract
    uniform motion so that the reference is continuous."""
    body_velocity: Tensor
    """(*b, 3) velocity over ground, commanded speeds included [m/s]."""
    left_foot_position: Tensor
    """(*b, 3) sole centre minus body [m]."""
    left_foot_velocity: Tensor
    """(*b, 3) velocity over ground, zero in stance [m/s]."""
    right_foot_position: Tensor
    """(*b, 3) sole centre minus body [m]."""
    right_foot_velocity: Tensor
    """(*b, 3) velocity over ground, zero in stance [m/s]."""
    body_heading: Tensor
    """(*b, 1) deviation of the body's heading from the mean heading [rad]."""
    left_foot_heading: Tensor
    """(*b, 1) direction of the toes, from the x axis of the frame; in stance it changes by minus
    the yaw rate [rad]."""
    right_foot_heading: Tensor
    """(*b, 1) direction of the toes, from the x axis of the frame [rad]."""

    @classmethod
    def of(cls, values: Tensor, widths: Sequence[int]) -> Reference:
        """Reference whose `COLUMNS` are (*b, k) values of given widths, left foot before right."""
        columns = dict(zip(COLUMNS, values.split(list(widths), dim=-1), strict=True))
        for name in _FEET:
            pair = columns.pop(name).chunk(2, dim=-1)
            columns |= {f"{side}_{name}": v for side, v in zip(SIDES, pair, strict=True)}
        return cls(**columns)
