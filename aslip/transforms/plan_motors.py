"""Motor angles, velocities and torques of plans."""

from __future__ import annotations

from typing import Any, Final

import torch
from torch import Tensor

from aslip.ik import LegTable
from aslip.planning import Pendulum
from aslip.transforms.rotation import rotate_about_vertical

MOTORS: Final = ("motor_position", "motor_velocity", "motor_torque")
"""Entries of `PlanMotors`."""
NEAR: Final = 0.003
"""Time between samples of a plan whose differences are accelerations [s]."""
_YIELD: Final = 0.034
"""Height by which a stance leg yields under the robot's weight, its springs and motors [m]."""


class PlanMotors:
    """Motor angles, velocities and torques of plans.

    The angles hold the pelvis level. Legs in flight are shorter than planned by what the pelvis
    sinks below the plan, as far as they do not bear its weight: else feet touch the ground early.

    Args:
        pendulum: model of the plans.
    """

    def __init__(self, pendulum: Pendulum) -> None:
        self.pendulum, self.legs = pendulum, LegTable()

    def __call__(self, later: Any, around: tuple[Any, Any]) -> dict[str, Tensor]:
        """Entries `MOTORS` (n, 10) of samples of n plans [rad, rad/s, N m].

        Args:
            later: samples at the end of a policy step.
            around: those a time `NEAR` before and after it.
        """
        before, after = around
        samples = before, later, after
        yaw, rate = (
            torch.stack(values)[..., None]
            for values in zip(*((s.heading.angle, s.heading.rate) for s in samples), strict=True)
        )
        places, shares = [_feet(sample) for sample in samples], [_share(s) for s in around]
        position, heading = (torch.stack(values) for values in zip(*places, strict=True))
        x, y, _ = position.unbind(-1)
        moves = [sample.feet.velocity - sample.body.velocity[:, None] for sample in samples]
        lifted = _YIELD * (shares[0] - shares[1]) / (2 * NEAR)
        moves = [torch.cat([move[..., :2], move[..., 2:] + lifted], -1) for move in moves]
        turning = (after.foot_heading - before.foot_heading) / (2 * NEAR)
        around_z = torch.stack([rate * y, -rate * x, 0 * x, turning - rate], -1)
        moved = around_z + torch.nn.functional.pad(_turned(torch.stack(moves), -yaw), (0, 1))
        angle, by_target = self.legs.motors(position, heading)
        slow, velocity, fast = (by_target @ moved[..., None])[..., 0].flatten(-2)
        # a motor that gets to a limit or leaves it between them has no acceleration, nor has a leg
        # whose foot touches the ground, in which it stops at once
        free = (slow != 0) & (fast != 0)
        free &= (before.contact == after.contact).repeat_interleave(free.shape[-1] // 2, -1)
        acceleration = torch.where(free, (fast - slow) / (2 * NEAR), 0.0)
        force = _turned(later.ground_force, -yaw[1])
        weight = force.new_tensor([0.0, 0.0, self.pendulum.gravity])
        pushed = force.sum(1) / self.pendulum.mass - weight
        torque = self.legs.torque(*places[1], force, later.pressure)
        torque = torque + self.legs.inertial_torque(angle[1], velocity, acceleration, pushed)
        return dict(zip(MOTORS, (angle[1], velocity, torque), strict=True))


def _feet(sample: Any) -> tuple[Tensor, Tensor]:
    """Places (n, 2, 3) [m] and headings (n, 2) [rad] of the feet, from the pelvis."""
    yaw = sample.heading.angle[:, None]
    position = sample.feet.position - sample.body.position[:, None]
    lifted = _YIELD * (1 - _share(sample))
    position = torch.cat([position[..., :2], position[..., 2:] + lifted], -1)
    return _turned(position, -yaw), sample.foot_heading - yaw


def _share(sample: Any) -> Tensor:
    """Share (n, 2, 1) of the load that each foot bears."""
    load = sample.ground_force[..., 2:]
    return load / load.sum(1, keepdim=True)


def _turned(vector: Tensor, yaw: Tensor) -> Tensor:
    """Vectors (*b, 2, 3) of the feet, turned by (*b, 1) [rad]."""
    return rotate_about_vertical(vector, yaw[..., None].expand(*vector.shape[:-1], 1))
