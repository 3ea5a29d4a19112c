"""Metrics of standing: feet on the ground, and how far the robot drifts and turns."""

from __future__ import annotations

import numpy as np

from aslip.robot.rotation import yaw
from aslip.walking.metrics.contact import both_feet

# time for which planted feet must carry a force [s]
_HOLD = 0.5


def planting_time(force: np.ndarray, period: float) -> float:
    """Time until both feet stay on the ground [s]; NaN if they do not.

    Args:
        force: (m, 2) vertical ground force of both feet [N].
        period: time between samples [s].

    Raises:
        ShapeError: `force` is not of two feet.
    """
    loaded = both_feet(force) > 0
    both = loaded[:, 0] & loaded[:, 1]
    count = round(_HOLD / period)
    if len(both) < count:
        return float("nan")
    # samples with an unloaded foot, up to each sample
    off = np.concatenate([[0], np.cumsum(~both)])
    held = np.flatnonzero(off[count:] == off[: len(off) - count])
    return float(held[0] * period) if len(held) else float("nan")


def lifted_feet(force: np.ndarray) -> int:
    """Number of times a foot leaves the ground or begins in the air, both feet counted.

    Args:
        force: (m, 2) vertical ground force of both feet [N].

    Raises:
        ShapeError: `force` is not of two feet.
    """
    loaded = both_feet(force) > 0
    return int((loaded[:-1] & ~loaded[1:]).sum() + (~loaded[:1]).sum())


def drift(position: np.ndarray) -> np.ndarray:
    """Horizontal distance (m,) from the first position [m].

    Args:
        position: (m, 3) or (m, 2) positions [m, world].
    """
    return np.linalg.norm(position[:, :2] - position[0, :2], axis=1)


def turned(orientation: np.ndarray) -> np.ndarray:
    """Turn (m,) about the vertical since the first orientation [rad].

    Args:
        orientation: (m, 4) orientations in the world, wxyz.
    """
    angle = np.unwrap(np.ravel(yaw(orientation)))
    return angle - angle[0]
