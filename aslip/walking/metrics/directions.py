"""Metrics of walks in all directions."""

from __future__ import annotations

import numpy as np

from aslip.base.interval import Interval
from aslip.robot import CASSIE
from aslip.robot.rotation import yaw


def mean_twist(velocity: np.ndarray, orientation: np.ndarray, yaw_rate: np.ndarray) -> np.ndarray:
    """Mean forward, sideways speed [m/s] and yaw rate [rad/s] of walks (n, 3), NaN after a fall.

    Args:
        velocity: (m, n, 3) velocity of the pelvis in the frame along the path [m/s].
        orientation: (m, n, 4) orientation of the pelvis in that frame, wxyz.
        yaw_rate: (n,) constant yaw rate of the frame [rad/s].
    """
    angle = np.unwrap(yaw(orientation), axis=0)
    turn = (angle[-1] - angle[0]) / ((len(angle) - 1) * CASSIE.policy_period)
    return np.concatenate([velocity.mean(axis=0)[:, :2], (yaw_rate + turn)[:, None]], axis=1)


def tracking_errors(twist: np.ndarray, command: np.ndarray) -> dict[str, Interval]:
    """Mean and 95th percentile of the errors of walks that did not fall, with their intervals.

    Args:
        twist: (n, 3) mean forward, sideways speed [m/s] and yaw rate [rad/s].
        command: (n, 3) commanded ones.

    Returns:
        "speed" and "speed_p95": length of the error of the velocity [m/s]; "turn" and "turn_p95":
        error of the yaw rate [rad/s]; NaN without walks. Intervals are over commands.
    """
    off = (twist - command)[np.isfinite(twist).all(axis=1)]
    speed, turn = np.linalg.norm(off[:, :2], axis=1), np.abs(off[:, 2])
    return {
        "speed": Interval.of([speed]),
        "speed_p95": Interval.of_quantile(speed, 0.95),
        "turn": Interval.of([turn]),
        "turn_p95": Interval.of_quantile(turn, 0.95),
    }
