r"""Rewards of the single-reference method of Xie et al. 2018, the paper's baseline (Sec. V).

The robot imitates one walking motion in joint space at every speed; only the path of the pelvis
follows the command. We use the motion of a linear inverted pendulum (`aslip.rom.pendulum`) instead
of the recorded one. Shapes: (*b, k) in, (*b, 1) out.
"""

from __future__ import annotations

import functools
from types import MappingProxyType
from typing import Final

import torch
from torch import Tensor

from aslip.robot import CASSIE, SIDES, STANDARD_GRAVITY

SINGLE_REFERENCE_WEIGHTS: Final = MappingProxyType(
    {"joints": 0.5, "pelvis": 0.3, "upright": 0.1, "springs": 0.1}
)
"""Weights of the baseline's reward; they sum to one."""

SHIN_COMPLIANCE: Final = -3.27e-4
"""Deflection of a shin's leaf spring per newton on the foot [rad/N]: slope of a line fitted to
deflection and vertical force of walking robots (correlation 0.97)."""

KNEELING_HEIGHT: Final = 0.75
"""Height of the pelvis below which the episode ends [m], as the robot is on its shins.

The public code limits the height of the tarsi instead. Without a limit, policies learn to walk
slowly on their knees: after 1.5 million policy steps, at 0 to 0.4 m/s, the pelvis is at 0.65 m
instead of 0.87 m or more."""

# weights of hip roll, hip yaw, hip pitch, knee and foot of both legs
_JOINT_WEIGHTS: Final = (0.15, 0.15, 0.1, 0.05, 0.05) * 2
# speed below which a foot of the reference is in stance [m/s]
_STANCE_SPEED = 0.05


def joints(qpos: Tensor, motor_reference: Tensor) -> Tensor:
    r""":math:`\exp(-30 \sum_i w_i (q_i - \hat q_i)^2)` over the motor joints.

    Args:
        qpos: (*b, 35).
        motor_reference: (*b, 10) angles at the same instant [rad].
    """
    error = qpos[..., _motors_and_shins()[0]] - motor_reference
    weights = error.new_tensor(_JOINT_WEIGHTS, dtype=torch.float32)
    return torch.exp(-30 * (weights * error.square()).sum(-1, keepdim=True))


def pelvis(pelvis_position: Tensor, body_position: Tensor, distance: Tensor) -> Tensor:
    r""":math:`\exp(-\|p - \hat p\|^2)`, along all three axes.

    Args:
        pelvis_position: (*b, 3) [m, world].
        body_position: (*b, 3) of the reference; x is the deviation from uniform motion [m].
        distance: (*b, 1) uniform motion since the start [m], from `ReferenceDistance`.
    """
    x, rest = body_position[..., :1] + distance, body_position[..., 1:]
    return torch.exp(-_square(pelvis_position - torch.cat([x, rest], dim=-1)))


def upright(pelvis_orientation: Tensor) -> Tensor:
    r""":math:`\exp(-\|(q_x, q_y, q_z)\|^2)` of the pelvis' quaternion.

    Args:
        pelvis_orientation: (*b, 4) wxyz.
    """
    return torch.exp(-_square(pelvis_orientation[..., 1:]))


def springs(qpos: Tensor, left_foot_velocity: Tensor, right_foot_velocity: Tensor) -> Tensor:
    r""":math:`\exp(-1000 \sum_i (s_i - \hat s_i)^2)` over both shins' leaf springs.

    The pendulum has no springs. Target deflections assume that the stance legs carry its weight,
    half each in double support.

    Args:
        qpos: (*b, 35).
        left_foot_velocity: (*b, 3) of the reference [m/s].
        right_foot_velocity: (*b, 3) of the reference [m/s].
    """
    speed = torch.stack([left_foot_velocity, right_foot_velocity], dim=-2).norm(dim=-1)
    stance = (speed < _STANCE_SPEED).to(qpos)
    share = stance / stance.sum(-1, keepdim=True).clamp(min=1)
    reference = SHIN_COMPLIANCE * CASSIE.total_mass * STANDARD_GRAVITY * share
    return torch.exp(-1000 * _square(qpos[..., _motors_and_shins()[1]] - reference))


@functools.cache
def _motors_and_shins() -> tuple[list[int], list[int]]:
    """Indices of the ten motor joints and the two shins in `qpos`."""
    shins = [CASSIE.skeleton.joints[f"{side}_shin"].qpos for side in SIDES]
    return CASSIE.indices.motor_qpos.tolist(), shins


def _square(vector: Tensor) -> Tensor:
    return vector.square().sum(dim=-1, keepdim=True)
