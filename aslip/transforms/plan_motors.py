"""Motor angles of plans, whose feet in flight start from where the pelvis is."""

from __future__ import annotations

from typing import Any, Final, NamedTuple, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from aslip.ik import LegTable
from aslip.planning import Pendulum
from aslip.robot import CASSIE
from aslip.transforms.rotation import (
    from_vector,
    multiply,
    rotate_about_vertical,
    rotate_inverse,
    yaw,
)

MOTORS: Final = ("motor_position", "motor_velocity", "motor_torque")
"""Entries of `PlanMotors`."""
NEAR: Final = 0.003
"""Time between samples of a plan whose differences are accelerations [s]."""

# time after lift-off and touchdown over which a foot goes from one view to the other [s]
_FADE = 0.1
# motors that turn the soles, each by the angle of its foot
_SOLES = [i for i, name in enumerate(CASSIE.motor_names) if name.endswith("_foot")]


class Pelvis(NamedTuple):
    """Estimated pelvis of n robots in a policy step."""

    away: Tensor
    """(n, 3) from the plan's body [m]."""
    orientation: Tensor
    """(n, 4) pelvis to the frame of the plan."""

    @property
    def pitch(self) -> Tensor:
        """(n, 1) its pitch, nose down [rad]."""
        w, x, y, z = self.orientation.split(1, dim=-1)
        return (2 * (w * y - z * x)).clamp(-1, 1).asin()

    @classmethod
    def expected(cls, found: TensorDictBase, body: Tensor, shift: Tensor) -> Pelvis:
        """Pelvis that is as far from the plan as now, and turns as now.

        Args:
            found: entries of the robots.
            body: (n, 3) the plan's body now [m].
            shift: (n, 2) origin of the plan's frame in that of the odometry [m].
        """
        odometry = cast("TensorDictBase", found["odometry"])
        place = odometry["pelvis_position"] - torch.nn.functional.pad(shift, (0, 1))
        rate = cast("Tensor", found["estimate", "angular_velocity"])
        turned = from_vector(rate * CASSIE.policy_period)
        orientation = multiply(cast("Tensor", odometry["pelvis_orientation"]), turned)
        return cls(place - body, orientation)

    def sees(self, sample: Any, turn: Tensor) -> tuple[Tensor, Tensor]:
        """Places (n, 2, 3) of feet in the pelvis' frame [m], and their headings (n, 2) [rad].

        Args:
            sample: sample of n plans.
            turn: (n,) yaw of the plan's body from when the pelvis has its orientation [rad].
        """
        turn = turn[:, None]
        leg = sample.feet.position - (sample.body.position + self.away)[:, None]
        leg = rotate_about_vertical(leg, -turn[:, None].expand(-1, 2, 1))
        orientation = self.orientation[:, None].expand(-1, 2, 4)
        heading = sample.foot_heading - yaw(self.orientation) - turn
        return rotate_inverse(orientation, leg), heading


class PlanMotors:
    """Motor angles, velocities and torques of plans.

    A foot in flight goes to its foothold from where the pelvis is, however that leans; the other
    legs are those of the plan, which hold the pelvis level.

    Args:
        pendulum: model of the plans.
    """

    def __init__(self, pendulum: Pendulum) -> None:
        self.pendulum, self.legs = pendulum, LegTable()

    def __call__(self, later: Any, around: tuple[Any, Any], pelvis: Pelvis) -> dict[str, Tensor]:
        """Entries `MOTORS` (n, 10) of samples of n plans [rad, rad/s, N m].

        Args:
            later: samples at the end of a policy step.
            around: those a time `NEAR` before and after it.
            pelvis: where the pelvis is estimated to be.
        """
        before, after = around
        samples = before, later, after
        yaw, rate = (
            torch.stack(values)[..., None]
            for values in zip(*((s.heading.angle, s.heading.rate) for s in samples), strict=True)
        )
        share = _in_flight(later, self.pendulum.double_stance)
        level = [_feet(sample) for sample in samples]
        seen = [pelvis.sees(s, s.heading.angle - later.heading.angle) for s in samples]
        places = [
            (torch.lerp(one[0], own[0], share[..., None]), torch.lerp(one[1], own[1], share))
            for one, own in zip(level, seen, strict=True)
        ]
        position, heading = (torch.stack(values) for values in zip(*places, strict=True))
        x, y, _ = position.unbind(-1)
        moves = [sample.feet.velocity - sample.body.velocity[:, None] for sample in samples]
        turning = (after.foot_heading - before.foot_heading) / (2 * NEAR)
        around_z = torch.stack([rate * y, -rate * x, 0 * x, turning - rate], -1)
        moved = around_z + torch.nn.functional.pad(_turned(torch.stack(moves), -yaw), (0, 1))
        angle, by_target = self.legs.motors(position, heading)
        slow, velocity, fast = (by_target @ moved[..., None])[..., 0].flatten(-2)
        # a motor that gets to a limit or leaves it between them has no acceleration
        free = (slow != 0) & (fast != 0)
        acceleration = torch.where(free, (fast - slow) / (2 * NEAR), 0.0)
        force = _turned(later.ground_force, -yaw[1])
        weight = force.new_tensor([0.0, 0.0, self.pendulum.gravity])
        pushed = force.sum(1) / self.pendulum.mass - weight
        torque = self.legs.torque(*places[1], force)
        torque = torque + self.legs.inertial_torque(angle[1], velocity, acceleration, pushed)
        turned = angle[1].clone()
        turned[:, _SOLES] += share * pelvis.pitch
        return dict(zip(MOTORS, (turned, velocity, torque), strict=True))


def _in_flight(sample: Any, double_stance: float) -> Tensor:
    """Share (n, 2) by which each foot flies, 0 in stance; it changes within a tenth of a second.

    Args:
        sample: sample of n plans.
        double_stance: time between a touchdown and the next lift-off [s].
    """
    since = sample.since[:, None]
    stands = torch.arange(2, device=since.device) == sample.stance[:, None]
    share = torch.where(stands, _FADE - since, since - double_stance) / _FADE
    share = share.clamp(0.0, 1.0)
    return share * share * (3 - 2 * share)


def _feet(sample: Any) -> tuple[Tensor, Tensor]:
    """Places (n, 2, 3) [m] and headings (n, 2) [rad] of the feet, from the pelvis."""
    yaw = sample.heading.angle[:, None]
    position = sample.feet.position - sample.body.position[:, None]
    return _turned(position, -yaw), sample.foot_heading - yaw


def _turned(vector: Tensor, yaw: Tensor) -> Tensor:
    """Vectors (*b, 2, 3) of the feet, turned by (*b, 1) [rad]."""
    return rotate_about_vertical(vector, yaw[..., None].expand(*vector.shape[:-1], 1))
