r"""The paper's five reward terms as pure functions of tensors (Sec. IV-B), and ten of our own.

Ours are for walks in all directions: the distance from the path, the heading, mechanical power,
the largest force on a foot, and friction that the feet spend against each other; the place of
one foot relative to the other, the time of its touchdown and a level pelvis; the velocity of the
reference, and the commanded one. Every term is :math:`\exp(-\text{distance})`, in [0, 1]. Distances
are Euclidean norms, as in the paper; the public code sums absolute values per axis for velocity and
feet. Shapes: (*b, k) in, (*b, 1) out.

"World" is the frame in which the caller gives the robot's poses, z up and x straight ahead; the
stacks pass the heading frame. The reference is in the same axes.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import torch
from torch import Tensor

from aslip.planning import Pendulum
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.transforms.rotation import (
    conjugate,
    multiply,
    rotate_about_vertical,
    rotate_inverse,
    vertical_quaternion,
    yaw,
    yaw_quaternion,
)

PAPER_WEIGHTS: Final = MappingProxyType(
    {
        "com_vel": 0.3,
        "foot_pos": 0.3,
        "straight_diff": 0.1,
        "foot_orient": 0.2,
        "action_diff": 0.1,
    }
)
"""Weights of the paper's reward; they sum to one."""


DIRECTION_WEIGHTS: Final = MappingProxyType(
    {
        "com_vel": 0.1,
        "foot_pos": 0.2,
        "path_diff": 0.15,
        "heading_diff": 0.1,
        "foot_orient": 0.05,
        "action_diff": 0.05,
        "power": 0.1,
        "landing": 0.15,
        "squeeze": 0.1,
    }
)
"""Weights of the reward for walks in all directions; they sum to one. Compared with the paper's,
`path_diff` takes the place of `straight_diff`; the terms for heading, power, landings and squeezing
are new."""

PLANNED_WEIGHTS: Final = MappingProxyType(
    {
        "velocity_diff": 0.12,
        "foot_pos": 0.02,
        "path_diff": 0.04,
        "heading_diff": 0.06,
        "level": 0.07,
        "foot_orient": 0.04,
        "action_diff": 0.02,
        "power": 0.02,
        "landing": 0.03,
        "squeeze": 0.02,
        "feet_apart": 0.14,
        "footstep": 0.26,
        "touchdown": 0.12,
        "speed_diff": 0.04,
    }
)
"""Weights of the reward for walks of a planner; they sum to one."""

_WEIGHT: Final = CASSIE.total_mass * STANDARD_GRAVITY  # [N]


def com_vel(
    pelvis_orientation: Tensor,
    pelvis_velocity: Tensor,
    body_velocity: Tensor,
    body_heading: Tensor | None = None,
) -> Tensor:
    r""":math:`\exp(-\|v_{CoM} - v_{refCoM}\|)`, both in the local pelvis frame (Eq. 2).

    The velocity is that of the pelvis' origin ("center of mass (pelvis) velocity"). The frame keeps
    the robot from earning reward by walking sideways or diagonally. Paper: local
    pelvis frame; public code: world frame; we follow the paper.

    Args:
        pelvis_orientation: (*b, 4) wxyz, pelvis to world.
        pelvis_velocity: (*b, 3) [m/s, world].
        body_velocity: (*b, 3) of the reference [m/s, same axes].
        body_heading: (*b, 1) of the reference [rad, same axes]; zero by default. Its velocity,
            too, is seen from its body.
    """
    velocity_b = rotate_inverse(pelvis_orientation, pelvis_velocity)
    return torch.exp(-_norm(velocity_b - _from_body(body_velocity, body_heading)))


def foot_pos(
    pelvis_orientation: Tensor,
    pelvis_position: Tensor,
    left_foot_position: Tensor,
    right_foot_position: Tensor,
    left_reference: Tensor,
    right_reference: Tensor,
    body_heading: Tensor | None = None,
) -> Tensor:
    r""":math:`\exp(-\|l - \hat l\| - \|r - \hat r\|)`, feet relative to the body.

    Both feet are seen in the pelvis-centred, yaw-aligned frame. Public code compares feet in the
    tilting pelvis frame with a level reference, an error of about 15 mm a degree of pitch. The
    scale is 1 m: errors of both feet that add up to 0.1 m cost a tenth of the term.

    Args:
        pelvis_orientation: (*b, 4) wxyz, pelvis to world.
        pelvis_position: (*b, 3) [m, world].
        left_foot_position: (*b, 3) [m, world].
        right_foot_position: (*b, 3) [m, world].
        left_reference: (*b, 3) left foot minus body [m, same axes].
        right_reference: (*b, 3) right foot minus body [m, same axes].
        body_heading: (*b, 1) of the reference [rad, same axes]; zero by default. Its feet, too,
            are seen from its body.
    """
    yaw = yaw_quaternion(pelvis_orientation)
    left = rotate_inverse(yaw, left_foot_position - pelvis_position)
    right = rotate_inverse(yaw, right_foot_position - pelvis_position)
    left = left - _from_body(left_reference, body_heading)
    right = right - _from_body(right_reference, body_heading)
    return torch.exp(-_norm(left) - _norm(right))


def straight_diff(pelvis_position: Tensor) -> Tensor:
    r""":math:`\exp(-|y|)`: "the lateral robot position being close to zero".

    As in the paper, there is no dead zone; the public code has one of 5 cm.

    Args:
        pelvis_position: (*b, 3) [m, world].
    """
    return torch.exp(-pelvis_position[..., 1:2].abs())


def path_diff(path_error: Tensor, body_position: Tensor, scale: float = 0.1) -> Tensor:
    r""":math:`\exp(-d / s)`, d the level distance of the pelvis from the reference.

    The distance accumulates errors of the mean velocity in any direction, which the oscillation
    over a stride hides from `com_vel`. Ours; see `aslip.transforms.HeadingFrame`.

    Args:
        path_error: (*b, 2) pelvis relative to the origin of the moving frame, forward and sideways
            [m].
        body_position: (*b, 3) body of the reference, relative to the same origin [m].
        scale: distance s at which the term is 1/e [m].
    """
    return torch.exp(-_norm(path_error - body_position[..., :2]) / scale)


def heading_diff(pelvis_orientation: Tensor, body_heading: Tensor, scale: float = 0.1) -> Tensor:
    r""":math:`\exp(-|\psi - \hat\psi| / s)`, the yaw of the pelvis from the reference's.

    Ours: `foot_orient` does not see slow turns of the pelvis over planted feet.

    Args:
        pelvis_orientation: (*b, 4) wxyz, pelvis to moving frame.
        body_heading: (*b, 1) of the reference, from the same frame [rad].
        scale: angle s at which the term is 1/e [rad].
    """
    turned = yaw(pelvis_orientation) - body_heading
    return torch.exp(-torch.atan2(turned.sin(), turned.cos()).abs() / scale)


def foot_orient(
    left_foot_orientation: Tensor,
    right_foot_orientation: Tensor,
    left_foot_heading: Tensor | None = None,
    right_foot_heading: Tensor | None = None,
) -> Tensor:
    r""":math:`\exp(-\|q_l - q^*\| - \|q_r - q^*\|)`: "forward pointing toes", feet level.

    :math:`q^*` is the identity: sole level, toes along the world's x. The paper gives no formula.
    This is the formula of its public code, with the signs of the quaternions made equal (10 degrees
    cost 0.087 per foot). Of the paper's terms, no other rewards the robot's heading. Feet have no
    roll motor and lean with the leg, by 0.04 rad on the reference, so the term is at most 0.96
    there.

    Args:
        left_foot_orientation: (*b, 4) wxyz, sole to world.
        right_foot_orientation: (*b, 4) wxyz, sole to world.
        left_foot_heading: (*b, 1) direction of the reference's toes [rad, same axes], which
            :math:`q^*` then has; straight ahead by default.
        right_foot_heading: (*b, 1) [rad, same axes].
    """
    left = _from_toes(left_foot_orientation, left_foot_heading)
    right = _from_toes(right_foot_orientation, right_foot_heading)
    return torch.exp(-_from_identity(left) - _from_identity(right))


def action_diff(action: Tensor, last_action: Tensor) -> Tensor:
    r""":math:`\exp(-\|a_t - a_{t-1}\|)` of the actions; `last_action` is zero after a reset.

    Args:
        action: (*b, 10) [rad].
        last_action: (*b, 10) [rad].
    """
    return torch.exp(-_norm(action - last_action))


def power(
    motor_power: Tensor, command: Tensor, scale: float = 0.4, speed_in_place: float = 0.4
) -> Tensor:
    r""":math:`\exp(-P / (s\,W (|v| + v_0)))`, P the positive mechanical power of the motors.

    W is the nominal robot's weight and v the commanded speed over the ground. Ours.

    Args:
        motor_power: (*b, 10) positive mechanical power, mean of a policy step [W].
        command: (*b, c) forward and sideways speed [m/s]; further numbers are ignored.
        scale: power over weight and speed s at which the term is 1/e.
        speed_in_place: speed v_0 that is added, as stepping in place takes power, too [m/s].
    """
    used = motor_power.sum(-1, keepdim=True)
    speed = _norm(command[..., :2]) + speed_in_place
    return torch.exp(-used / (scale * _WEIGHT * speed))


def landing(largest_force: Tensor, least_load: float = 0.9, scale: float = 0.6) -> Tensor:
    r""":math:`\exp(-(F/W - l)^+ / s)`, F the vertical force on the foot that bears more.

    W is the nominal robot's weight. It reads the largest force of a policy step, as feet land
    within milliseconds, which the mean does not show. Ours.

    Args:
        largest_force: (*b, 2) vertical force on left and right foot, largest of a policy step [N].
        least_load: force over weight l up to which the term is 1.
        scale: force over weight s, beyond `least_load`, at which the term is 1/e.
    """
    largest = largest_force.amax(-1, keepdim=True) / _WEIGHT
    return torch.exp(-(largest - least_load).clamp(min=0) / scale)


def squeeze(ground_force: Tensor, scale: float = 10.0) -> Tensor:
    r""":math:`\exp(-S / s)`, S the friction that feet spend against each other.

    :math:`S = \|h_l\| + \|h_r\| - \|h_l + h_r\|`, with the horizontal forces h on both feet, is 0
    in single stance, and whenever both feet push in the same direction. Ours: feet of a robot that
    stands creep on soft contacts under forces of a few newtons, too slowly for other terms to see.

    Args:
        ground_force: (*b, 2, 3) force of the ground on the left and the right foot [N, world], mean
            of a policy step.
        scale: force s at which the term is 1/e [N].
    """
    horizontal = ground_force[..., :2]
    spent = _norm(horizontal).sum(-2) - _norm(horizontal.sum(-2))
    return torch.exp(-spent / scale)


def _norm(vector: Tensor) -> Tensor:
    return torch.linalg.vector_norm(vector, dim=-1, keepdim=True)


def _from_identity(quaternion: Tensor) -> Tensor:
    """Distance (*b, 1) of quaternions (*b, 4) from the identity; their signs do not matter."""
    w, vector = quaternion[..., :1].abs(), quaternion[..., 1:]
    return _norm(torch.cat([w - 1, vector], dim=-1))


def _from_body(vector: Tensor, heading: Tensor | None) -> Tensor:
    """Vectors (*b, 3) in the axes of a body with a heading (*b, 1), by default zero."""
    return vector if heading is None else rotate_about_vertical(vector, -heading)


def _from_toes(orientation: Tensor, heading: Tensor | None) -> Tensor:
    """Orientations (*b, 4) relative to level feet with a heading (*b, 1), by default zero."""
    if heading is None:
        return orientation
    return multiply(conjugate(vertical_quaternion(heading)), orientation)


def feet_apart(
    left_foot_position: Tensor,
    right_foot_position: Tensor,
    left_reference: Tensor,
    right_reference: Tensor,
    scale: float = 0.04,
) -> Tensor:
    r""":math:`f(\|(l - r) - (\hat l - \hat r)\|)`, one foot relative to the other.

    The function f is that of `footstep`. The foot in stance is where it is, so that this is the
    distance of the swing foot from its planned place, whatever the body does. Ours, for footholds
    that must be hit.

    Args:
        left_foot_position: (*b, 3) [m, world].
        right_foot_position: (*b, 3) [m, world].
        left_reference: (*b, 3) left foot minus body [m, same axes].
        right_reference: (*b, 3) right foot minus body [m, same axes].
        scale: distance s [m].
    """
    apart = left_foot_position - right_foot_position
    return _near(_norm(apart - left_reference + right_reference), scale)


def footstep(
    left_foot_position: Tensor,
    right_foot_position: Tensor,
    last_foothold: Tensor,
    state: Tensor,
    step: Tensor,
    scale: float = 0.03,
) -> Tensor:
    r""":math:`f(d)`, d the distance of the foot in stance from its foothold.

    .. math:: f(d) = (e^{-d / s} + \max(0, 1 - d / 5 s)) / 2

    The exponential alone is flat where feet land far off, as they do at first from long reaches.
    The distance is along the ground. The term is 1 in policy steps in which the plan puts a foot
    down, and for robots that follow no plan.

    Args:
        left_foot_position: (*b, 3) [m].
        right_foot_position: (*b, 3) [m].
        last_foothold: (*b, 3) where the foot in stance was to land [m, same frame].
        state: (*b, 31) state of the plan, see `aslip.planning.WalkState.to_rows`.
        step: (*b, 5) `PLAN_SIZES["step"]` of `aslip.transforms.planned`, zero without a plan.
        scale: distance s [m].
    """
    right = state[..., -2:-1] > 0
    stood = torch.where(right, right_foot_position, left_foot_position)
    found = _near(_norm((stood - last_foothold)[..., :2]), scale)
    counts = (state[..., -1:] > CASSIE.policy_period) & (step[..., -1:] != 0)
    return torch.where(counts, found, 1.0)


def _near(distance: Tensor, scale: float) -> Tensor:
    """Term f of `footstep`."""
    return (torch.exp(-distance / scale) + (1 - distance / (5 * scale)).clamp(min=0.0)) / 2


def touchdown(
    ground_force: Tensor,
    state: Tensor,
    step: Tensor,
    double_stance: float = Pendulum.double_stance,
    scale: float = 0.1,
) -> Tensor:
    r""":math:`\exp(-F / (s W))`, F the load that a foot has in flight or lacks after its touchdown.

    W is the nominal robot's weight, and :math:`s W` the load that a foot has at least when it is
    down. Neither counts in policy steps in which the plan lifts the foot or puts it down, nor of
    robots that follow no plan. Ours, for feet that land when they should.

    Args:
        ground_force: (*b, 2, 3) force of the ground on left and right foot [N, world], mean of a
            policy step.
        state: (*b, 31) state of the plan after it, see `aslip.planning.WalkState.to_rows`.
        step: (*b, 5) `PLAN_SIZES["step"]` of `aslip.transforms.planned` when the policy step began,
            zero without a plan.
        double_stance: time after a touchdown at which the other foot lifts off [s].
        scale: force over weight s at which the term is 1/e.
    """
    stance, since = state[..., -2:-1], state[..., -1:]
    left, right = (ground_force[..., 2] / _WEIGHT).split(1, dim=-1)
    stood, swung = torch.where(stance > 0, right, left), torch.where(stance > 0, left, right)
    period = CASSIE.policy_period
    flies = (since > double_stance + period) & (step[..., 3:4] > period)
    # a foot below the edge of a stone is pushed down
    early = torch.where(flies, swung.clamp(min=0.0), 0.0)
    late = torch.where(since > period, (scale - stood).clamp(min=0.0), 0.0)
    return torch.exp(-torch.where(step[..., -1:] != 0, early + late, 0.0) / scale)


def level(pelvis_orientation: Tensor, scale: float = 0.1) -> Tensor:
    r""":math:`\exp(-\sin\alpha / s)`, :math:`\alpha` the tilt of the pelvis.

    The legs in stance have the motor angles of a level pelvis. Ours.

    Args:
        pelvis_orientation: (*b, 4) wxyz, pelvis to world.
        scale: sine s of the tilt at which the term is 1/e.
    """
    up = pelvis_orientation.new_tensor([0.0, 0.0, 1.0]).expand(*pelvis_orientation.shape[:-1], 3)
    return torch.exp(-_norm(rotate_inverse(pelvis_orientation, up)[..., :2]) / scale)


def velocity_diff(
    pelvis_orientation: Tensor,
    pelvis_velocity: Tensor,
    body_velocity: Tensor,
    body_heading: Tensor,
    scale: float = 0.1,
) -> Tensor:
    r""":math:`\exp(-\|v - \hat v\| / s)` of the velocity along the ground and the reference's.

    Stones determine the steps, so that a body that is slower than its plan falls back from the next
    one; `com_vel` has a scale of 1 m/s. Ours.

    Args:
        pelvis_orientation: (*b, 4) wxyz, pelvis to world.
        pelvis_velocity: (*b, 3) [m/s, world].
        body_velocity: (*b, 3) of the reference [m/s, same axes].
        body_heading: (*b, 1) of the reference [rad, same axes]. Its velocity is seen from its body.
        scale: difference s at which the term is 1/e [m/s].
    """
    ahead = rotate_inverse(yaw_quaternion(pelvis_orientation), pelvis_velocity)
    return torch.exp(-_norm((ahead - _from_body(body_velocity, body_heading))[..., :2]) / scale)


def speed_diff(pelvis_velocity: Tensor, command: Tensor, scale: float = 0.3) -> Tensor:
    r""":math:`\exp(-\|v - \hat v\| / s)` of the velocity along the ground and the plan's mean.

    Of robots that follow the library it is the commanded one.

    A plan goes on from where the robot is, so that one which is slower than commanded would hardly
    lose reward by the other terms. Ours.

    Args:
        pelvis_velocity: (*b, 3) [m/s, heading frame].
        command: (*b, 2 or 3) mean velocity of the body over all steps of the plan [m/s, heading
            frame]; a yaw rate after it does not count.
        scale: difference s at which the term is 1/e [m/s].
    """
    return torch.exp(-_norm(pelvis_velocity[..., :2] - command[..., :2]) / scale)
