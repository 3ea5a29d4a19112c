"""Heading frames of robots that estimate their own state: rotation, and path of a command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from aslip.control.estimates import POSITION, check_first, mark_lost, split_estimate
from aslip.robot import Robot
from aslip.robot.rotation import yaw
from aslip.transforms.estimate import PATH_SIZES
from aslip.transforms.path import advance_frame, advance_heading, place_in_path
from aslip.transforms.rotation import (
    multiply,
    rotate_about_vertical,
    upper_hemisphere,
    vertical_quaternion,
)

# quaternions within this tolerance of unit length keep their bits
_ROUNDING = 1e-6


Entries = dict[str, Tensor | dict[str, Tensor]]
"""Entries (n, k), or groups of them."""


def start_entries(
    rows: np.ndarray, heading: np.ndarray | None, robot: Robot, along_path: bool = False
) -> Entries:
    """Entries `estimate` and `heading` of robots that start with estimates.

    Args:
        rows: (n, e) joined estimates.
        heading: (n, 1) yaw that counts as straight ahead, in the frame of the estimates [rad]; by
            default that of the estimates.
        robot: robot that gives the sizes of the entries.
        along_path: True for robots along a path, which have `odometry`, too, if their estimates
            have positions; see `place_on_path`.

    Raises:
        ConfigurationError: an estimate is not finite, or a robot cannot have it.
    """
    check_first(rows, robot)
    part, position = _tensors(rows, robot)
    if heading is None:
        heading = yaw(part["orientation"].numpy())[:, None]
    turn = torch.from_numpy(heading)
    entries: Entries = {"estimate": turn_estimate(part, turn), "heading": turn}
    if along_path and position is not None:
        origin = torch.nn.functional.pad(position[:, :2], (0, 1)).float()
        turned = rotate_about_vertical(position, -turn)
        entries["odometry"] = place_on_path(turned, origin, turn.float())
    return entries


def next_entries(
    past: TensorDictBase,
    rows: np.ndarray,
    heading: Tensor | None,
    robot: Robot,
    command: Tensor | None = None,
    mode: Tensor | None = None,
) -> Entries:
    """Entries `estimate` and `heading` after new estimates (n, e); see `hold_estimate`.

    Estimates that no robot can have count as lost.

    Args:
        past: entries of the last policy step; with `odometry` there, the robots have it again.
        rows: joined estimates.
        heading: new yaw (n, 1) that counts as straight ahead [rad], or None.
        robot: robot that gives the sizes of the entries.
        command: command (n, c) during the step, along whose path the heading turns, or None.
        mode: new mode (n, 1) of robots that take stand commands, or None.
    """
    before = cast("Tensor", past["heading"] if heading is None else heading)
    turn = (before if command is None else advance_heading(before, command)).double()
    last = {name: cast("Tensor", past["estimate", name]) for name in robot.estimate_sizes}
    part, position = _tensors(mark_lost(rows, robot), robot)
    entries: Entries = {"estimate": hold_estimate(part, turn, last), "heading": turn.clone()}
    if command is not None and "odometry" in past:
        if position is None:
            position = torch.full((len(rows), 3), torch.nan, dtype=torch.float64)
        origin, error = (cast("Tensor", past["odometry", name]) for name in PATH_SIZES)
        moved = advance_frame(origin, before.float(), command, error)
        turned = rotate_about_vertical(position, -turn)
        entries["odometry"] = place_on_path(turned, *moved, error, mode)
    return entries


def place_on_path(
    position: Tensor,
    origin: Tensor,
    heading: Tensor,
    last_error: Tensor | None = None,
    mode: Tensor | None = None,
) -> dict[str, Tensor]:
    """Odometry of robots along the path of a command, see `aslip.transforms.path`.

    Args:
        position: (n, 3) position of the pelvis [m, heading frame]; not finite if it is lost.
        origin: (n, 3) origin of the moving frame [m, frame of the estimates].
        heading: (n, 1) yaw of the frame [rad].
        last_error: (n, 2) distance from the path a policy step ago, which lost robots keep [m].
        mode: (n, 1) mode of robots that take stand commands.

    Returns:
        `origin` (n, 3), and `path_error` (n, 2) as in `aslip.transforms.PATH_SIZES`.
    """
    relative = position.float() - rotate_about_vertical(origin, -heading)
    placed = place_in_path({"pelvis_position": relative}, origin, heading, mode=mode)
    odometry = {name: placed[name] for name in PATH_SIZES}
    if last_error is None:
        return odometry
    lost = ~position.isfinite().all(-1, keepdim=True)
    held = {"origin": origin, "path_error": last_error}
    return {name: torch.where(lost, held[name], value) for name, value in odometry.items()}


def hold_estimate(
    part: Mapping[str, Tensor], heading: Tensor, last: Mapping[str, Tensor]
) -> dict[str, Tensor]:
    """Rotate estimates to the heading frame; keep a robot's last one if a number is not finite.

    Args:
        part: entries (n, k) of new estimates, in double precision.
        heading: (n, 1) yaw of the heading frame [rad].
        last: entries (n, k) of the last estimates in the heading frame.
    """
    lost = ~torch.cat(list(part.values()), dim=-1).isfinite().all(-1, keepdim=True)
    turned = turn_estimate(part, heading)
    return {name: torch.where(lost, last[name], value) for name, value in turned.items()}


def turn_estimate(part: Mapping[str, Tensor], heading: Tensor) -> dict[str, Tensor]:
    """Rotate estimates to heading frames, with x along the heading, in single precision.

    Args:
        part: entries (n, k) of estimates in double precision; a zero heading keeps them exactly.
        heading: (n, 1) yaw of the heading frame, in the frame of the estimates [rad].
    """
    orientation = multiply(vertical_quaternion(-heading), part["orientation"])
    length = torch.linalg.vector_norm(orientation, dim=-1, keepdim=True)
    far = (length - 1).abs() > _ROUNDING
    unit = torch.where(far, orientation / length, orientation)
    turned = {
        **part,
        "orientation": upper_hemisphere(unit),
        "velocity": rotate_about_vertical(part["velocity"], -heading),
    }
    return {name: value.float() for name, value in turned.items()}


def _tensors(rows: np.ndarray, robot: Robot) -> tuple[dict[str, Tensor], Tensor | None]:
    """Split joined estimates (n, e) into entries (n, k) and, if they have it, the position."""
    parts = {name: torch.tensor(value) for name, value in split_estimate(rows, robot).items()}
    position = parts.pop(POSITION, None)
    return parts, position
