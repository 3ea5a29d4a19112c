"""Footsteps, and their error against the reduced-order model (Sec. V-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aslip.errors import ShapeError
from aslip.robot import SIDES
from aslip.robot.rotation import rotate_level
from aslip.walking.metrics.contact import SHORTEST_SWING, stances

# duration at mid-stance over which the foot position is averaged [s]
_MIDDLE = 0.03


@dataclass(frozen=True)
class Footsteps:
    """Footsteps of both feet in order of touchdown, k of them."""

    side: np.ndarray
    """(k,) 0 for left, 1 for right."""
    time: np.ndarray
    """(k,) instant of touchdown [s]."""
    position: np.ndarray
    """(k, 2) position of the foot at mid-stance [m, world]."""
    heading: np.ndarray
    """(k,) yaw of the robot's heading at touchdown [rad]."""


@dataclass(frozen=True)
class Placement:
    """Errors of j footsteps against their ideal positions."""

    side: np.ndarray
    """(j,) 0 for left, 1 for right."""
    offset: np.ndarray
    """(j, 2) actual minus ideal position, forward and left [m]."""
    width: np.ndarray
    """(j,) lateral distance from the previous footstep [m]."""

    @property
    def error(self) -> np.ndarray:
        """(j,) distances [m]."""
        return np.linalg.norm(self.offset, axis=1)

    @property
    def outward(self) -> np.ndarray:
        """(j,) lateral offset away from the body [m], positive to the left for left feet."""
        return np.where(self.side == SIDES.index("left"), 1.0, -1.0) * self.offset[:, 1]


def footsteps(
    force: np.ndarray,
    foot: np.ndarray,
    period: float,
    swing: float = SHORTEST_SWING,
    heading: np.ndarray | None = None,
) -> Footsteps:
    """Find the footsteps of a walk.

    Args:
        force: (m, 2) vertical ground force, left and right [N].
        foot: (m, 2, 3) sole centres [m, world], or at least their x and y.
        period: time between samples [s].
        swing: shortest swing [s].
        heading: (m,) yaw of the heading [rad]; zero by default.

    Raises:
        ShapeError: an array has another shape.
    """
    heading = np.zeros(len(force)) if heading is None else heading
    if force.ndim != 2 or force.shape[1] != 2 or foot.shape[:2] != force.shape:
        raise ShapeError(
            f"force must be (m, 2) and foot (m, 2, 3), got {force.shape}, {foot.shape}"
        )
    side, first, places = [], [], []
    half = max(round(_MIDDLE / period), 1) / 2
    for i in range(2):
        for start, stop in stances(force[:, i], period, swing=swing):
            middle = (start + stop) / 2
            low, high = int(np.ceil(middle - half)), int(np.floor(middle + half))
            side.append(i)
            first.append(start)
            places.append(foot[low : max(high, low + 1), i, :2].mean(axis=0))
    order = np.argsort(first, kind="stable")
    first = np.array(first, dtype=int)[order]
    return Footsteps(
        np.array(side, dtype=int)[order],
        first * period,
        np.array(places, dtype=float).reshape(-1, 2)[order],
        heading[first],
    )


def placement(steps: Footsteps, ideal_step: np.ndarray) -> Placement:
    """Compare footsteps with the reduced-order model's.

    The ideal position is the previous footstep's actual position plus the step of the reduced-order
    model at the command, turned by the heading. Only footsteps after one of the other foot count.

    Args:
        steps: footsteps of a walk at one command.
        ideal_step: (2, 2) step of the left and of the right foot from the other, forward and left
            [m]; see `aslip.library.footholds.Footholds.step`.
    """
    follows = np.flatnonzero(np.diff(steps.side) != 0) + 1
    side = steps.side[follows]
    step = steps.position[follows] - steps.position[follows - 1]
    step = rotate_level(step, -steps.heading[follows])
    return Placement(side, step - np.asarray(ideal_step)[side], np.abs(step[:, 1]))
