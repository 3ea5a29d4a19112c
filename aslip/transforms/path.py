"""Path that a command describes: heading and origin of the frame that moves along it.

Over a policy step, the moving frame of `aslip.library.Reference` moves and turns in the world with
the twist of the command, which is that of the pelvis: the frame turns about the pelvis, wherever
its origin is. So a pelvis at rest in the frame has the commanded velocity in turns, too. If the
frame turned about its origin, a pelvis d behind it would move sideways at d times the yaw rate.
Truth and estimates use the same functions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor

from aslip.library import WalkMode
from aslip.robot import CASSIE
from aslip.transforms.rotation import conjugate, heading_to_world, rotate_inverse

LEASH: Final = 0.1
"""Length of a slack leash from the pelvis to the origin of the moving frame along the ground [m].
A pelvis further away drags the origin along, so that it need not walk back after a push. During a
stop the origin is below the pelvis, so that the robot stands where it comes to rest."""

LEASH_TIME: Final = 1.0
"""Time constant with which a taut leash shortens [s]. At an error v of the mean velocity, the
distance settles at `LEASH` + v x `LEASH_TIME`, and so shows how large the error is."""


def advance_heading(heading: Tensor, command: Tensor) -> Tensor:
    """Yaw (*b, 1) of the moving frame a policy step later, from -pi to pi [rad].

    Single precision loses small yaw rates at a yaw of many turns, hence the wrap.

    Args:
        heading: (*b, 1) yaw [rad].
        command: (*b, c) forward, sideways speed [m/s], yaw rate [rad/s]; missing ones are zero.
    """
    if command.shape[-1] < 3:
        return heading
    return wrap(heading + CASSIE.policy_period * command[..., 2:3])


def wrap(angle: Tensor) -> Tensor:
    """Angles moved by whole turns to -pi to pi [rad]; others stay as they are, bit for bit."""
    turns = (angle / (2 * math.pi)).round()
    return torch.where(angle.abs() > math.pi, angle - 2 * math.pi * turns, angle)


def advance_frame(
    origin: Tensor,
    heading: Tensor,
    command: Tensor,
    error: Tensor,
) -> tuple[Tensor, Tensor]:
    """Origin (*b, 3) [m, world] and yaw (*b, 1) [rad] of the moving frame a policy step later.

    Arguments are those of `advance_heading`, `origin` (*b, 3) on a level floor [m, world], and
    `error` (*b, 2), the pelvis from the origin before the step [m, heading frame].
    """
    after = advance_heading(heading, command)
    return move_origin(origin, heading, advance(command, error)), after


def advance(command: Tensor, error: Tensor) -> Tensor:
    """Displacement (*b, 3) of the origin over a policy step, in the frame at its start [m].

    It is that of `arc`, and that by which the turn about the pelvis moves the origin.

    Args:
        command: (*b, c) forward, sideways speed [m/s], yaw rate [rad/s]; missing ones are zero.
        error: (*b, 2) pelvis from the origin before the step [m, frame at its start].
    """
    angle = CASSIE.policy_period * _complete(command)[..., 2:]
    # half angles, as 1 - cos of small angles loses digits
    less, sine = 2 * (angle / 2).sin().square(), angle.sin()
    x, y = error.split(1, dim=-1)
    swung = torch.cat([less * x + sine * y, less * y - sine * x, torch.zeros_like(x)], dim=-1)
    return arc(command) + swung


def arc(command: Tensor) -> Tensor:
    """Displacement (*b, 3) of the moving frame over a policy step, in the frame at its start [m].

    The displacement is the chord of a circular arc: for speed v, yaw rate w and period T, its
    length is v T sin(a)/a with a = w T/2, and it is turned by a.

    Args:
        command: (*b, c) forward, sideways speed [m/s], yaw rate [rad/s]; missing ones are zero.
    """
    forward, sideways, yaw_rate = _complete(command).split(1, dim=-1)
    angle = CASSIE.policy_period * yaw_rate / 2
    chord = CASSIE.policy_period * torch.sinc(angle / math.pi)
    cosine, sine = angle.cos(), angle.sin()
    x, y = cosine * forward - sine * sideways, sine * forward + cosine * sideways
    return torch.cat([chord * x, chord * y, torch.zeros_like(x)], dim=-1)


def move_origin(
    origin: Tensor, heading: Tensor, displacement: Tensor, slope: Tensor | None = None
) -> Tensor:
    """Origin (*b, 3) after a displacement along the ground [m, world].

    Args:
        origin: (*b, 3) point on the floor [m, world].
        heading: (*b, 1) yaw of the heading frame [rad].
        displacement: (*b, 3) level displacement [m, heading frame].
        slope: (*b, 1) slope of the floor, the world's xy plane [rad]; level by default.
    """
    slope = torch.zeros_like(heading) if slope is None else slope
    from_world = conjugate(heading_to_world(slope, heading))
    moved = origin + rotate_inverse(from_world, displacement)
    # back to the floor along gravity, which keeps x and y in the heading frame
    up = torch.cat([slope.sin(), torch.zeros_like(slope), slope.cos()], dim=-1)
    return moved - up * (moved[..., 2:] / up[..., 2:])


def dragged(pelvis_position: Tensor, mode: Tensor | None = None) -> Tensor:
    """Level displacement (*b, 3) of the origin by the leash in a policy step [m, heading frame].

    Args:
        pelvis_position: (*b, 3) position relative to the origin [m, heading frame].
        mode: (*b, 1) values of `WalkMode`, in a stop of which the origin goes to the pelvis; None
            for robots that walk.
    """
    level = torch.nn.functional.pad(pelvis_position[..., :2], (0, 1))
    distance = torch.linalg.vector_norm(level, dim=-1, keepdim=True)
    taut = 1 - LEASH / distance.clamp(min=LEASH)
    drag = level * taut * (CASSIE.policy_period / LEASH_TIME)
    return drag if mode is None else torch.where(mode == WalkMode.STOP, level, drag)


def place_in_path(
    entries: Mapping[str, Tensor],
    origin: Tensor,
    heading: Tensor,
    slope: Tensor | None = None,
    mode: Tensor | None = None,
) -> dict[str, Tensor]:
    """Drag the origin of odometry along with the pelvis; add `origin` and `path_error`.

    Args:
        entries: positions, orientations and velocities of `ODOMETRY_SIZES`, relative to `origin`.
        origin: (*b, 3) origin of the moving frame [m, world].
        heading: (*b, 1) yaw of the frame [rad].
        slope: (*b, 1) slope of the floor [rad]; level by default.
        mode: (*b, 1) values of `WalkMode`, see `dragged`; None for robots that walk.

    Returns:
        The entries; `origin` (*b, 3) [m, world]; and `path_error` (*b, 2), forward and sideways
        distance of the pelvis from the origin [m, heading frame].
    """
    drag = dragged(entries["pelvis_position"], mode)
    placed = {
        name: value - drag if name.endswith("_position") else value
        for name, value in entries.items()
    }
    error = placed["pelvis_position"][..., :2].clone()
    return {**placed, "origin": move_origin(origin, heading, drag, slope), "path_error": error}


def _complete(command: Tensor) -> Tensor:
    """Pad commands (*b, c) with zeros to (*b, 3)."""
    return torch.nn.functional.pad(command, (0, 3 - command.shape[-1]))
