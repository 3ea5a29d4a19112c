"""Rotation of estimates to heading frames, for robots that estimate their own state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch import Tensor

from aslip.control.own_estimate import split_estimate, start_heading
from aslip.robot import Robot
from aslip.transforms.rotation import (
    multiply,
    rotate_about_vertical,
    upper_hemisphere,
    vertical_quaternion,
)

# quaternions within this tolerance of unit length keep their bits
_ROUNDING = 1e-6


def start_entries(
    rows: np.ndarray, heading: ArrayLike | None, robot: Robot
) -> dict[str, Tensor | dict[str, Tensor]]:
    """Entries `estimate` and `heading` of robots that start with estimates (n, e).

    Arguments and errors are those of `start_heading`.
    """
    ahead = torch.from_numpy(start_heading(rows, heading, robot))
    return {"estimate": turn_estimate(_tensors(rows, robot), ahead), "heading": ahead}


def next_entries(
    past: TensorDictBase, rows: np.ndarray, heading: Tensor | None, robot: Robot
) -> dict[str, Tensor | dict[str, Tensor]]:
    """Entries `estimate` and `heading` after new estimates (n, e); see `hold_estimate`.

    Args:
        past: entries of the last policy step.
        rows: joined estimates.
        heading: new yaw (n, 1) that counts as straight ahead [rad], or None.
        robot: robot that gives the sizes of the entries.
    """
    ahead = cast("Tensor", past["heading"] if heading is None else heading.double())
    last = {name: cast("Tensor", past["estimate", name]) for name in robot.estimate_sizes}
    return {"estimate": hold_estimate(_tensors(rows, robot), ahead, last), "heading": ahead.clone()}


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


def _tensors(rows: np.ndarray, robot: Robot) -> dict[str, Tensor]:
    """Split joined estimates (n, e) into entries (n, k)."""
    parts = split_estimate(rows, robot)
    return {name: torch.tensor(value) for name, value in parts.items()}
