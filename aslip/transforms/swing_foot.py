"""Feet of a plan in flight, seen from a pelvis that is not where the plan has it."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from aslip.robot import CASSIE
from aslip.transforms.rotation import (
    from_vector,
    multiply,
    rotate_about_vertical,
    rotate_inverse,
    yaw,
)

# time after lift-off and touchdown over which a foot goes from one view to the other [s]
_FADE = 0.1
# motors that turn the soles, each by the angle of its foot
SOLES = [i for i, name in enumerate(CASSIE.motor_names) if name.endswith("_foot")]


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


def in_flight(sample: Any, double_stance: float) -> Tensor:
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
