"""Where plans begin on a gait of the library, and the clock's phase of a plan."""

from __future__ import annotations

import torch
from torch import Tensor

from aslip.library import GaitLibrary
from aslip.library.transitions import HALF
from aslip.planning import WalkState
from aslip.transforms.rotation import rotate_about_vertical

# share of a stride in double stance after each touchdown
_DOUBLE = 0.125


def start_state(
    library: GaitLibrary, phase: Tensor, command: Tensor, pelvis: Tensor, ground: Tensor
) -> WalkState:
    """State of n robots on gaits of the library.

    The left foot lifts off at phase 0 and the right one at 0.5; feet land an eighth before.

    Args:
        library: gaits.
        phase: (n, 1) stride fraction.
        command: (n, 3) command of the gait.
        pelvis: (n, 3) place of the pelvis, of which only x and y count [m].
        ground: (n, 1) height of the ground below the robot [m].
    """
    stride = library.stride(command)
    passed = torch.remainder(phase + _DOUBLE, 1.0)  # since the right touchdown
    stance = (passed < HALF).long()[:, 0]
    right = (stance == 1)[:, None]
    found = library.lookup(phase, command)
    lifted = torch.where(right, 0.0, HALF)
    before = library.lookup(lifted, command)
    # from the foot in stance to the other, when that lifted off
    step = before.left_foot_position - before.right_foot_position
    step = torch.where(right, step, -step)
    elapsed = (torch.remainder(passed, HALF) - _DOUBLE).clamp(min=0.0) * stride
    step = rotate_about_vertical(step, -command[:, 2:] * elapsed)
    place = torch.cat([pelvis[:, :2], ground], -1)
    body = torch.cat([place[:, :2], found.body_position[:, 2:] + ground], -1)
    feet = torch.stack([found.left_foot_position, found.right_foot_position], 1) + body[:, None]
    stood = feet[torch.arange(len(phase), device=phase.device), stance]
    return WalkState(
        body_position=body,
        body_velocity=found.body_velocity,
        foot_position=feet,
        foot_velocity=torch.stack([found.left_foot_velocity, found.right_foot_velocity], 1),
        foot_acceleration=torch.zeros_like(feet),
        foot_heading=torch.cat([found.left_foot_heading, found.right_foot_heading], -1),
        lift_off=torch.cat([(stood + step)[:, :2], ground], -1),
        stance=stance,
        since=(torch.remainder(passed, HALF) * stride)[:, 0],
    )


def phase_of(state: WalkState, left: Tensor, stride: Tensor) -> Tensor:
    """Stride fraction (n, 1) from which the library's clock lands when the plan does.

    Args:
        state: state of n robots.
        left: (n, 1) time until the plan's next touchdown [s].
        stride: (n, 1) stride of the library [s].
    """
    since, touchdown = state.since[:, None], HALF - _DOUBLE
    landed = since < _DOUBLE * stride
    within = torch.where(landed, touchdown + since / stride, (touchdown - left / stride).clip(0.0))
    # the left foot swings in the first half of the stride, and has just landed at its end
    first = (state.stance[:, None] == 0) == landed
    return torch.where(first, within, HALF + within) % 1.0
