"""How a walk resembles the reduced-order model it follows."""

from __future__ import annotations

import numpy as np


def root_mean_square(error: np.ndarray) -> np.ndarray | float:
    """Root mean square over time, of (m, ...) errors."""
    return np.sqrt(np.mean(np.square(error), axis=0))


def leg_length_correlation(robot: np.ndarray, model: np.ndarray) -> float:
    """Pearson's correlation of leg lengths, robot against reduced-order model.

    Leg length is the distance from body to foot. The paper sees "changes in leg length directly
    corresponding" to the model's (Sec. V-B); this is a number for it. NaN if one is constant.

    Args:
        robot: (m, 2) lengths of left and right leg [m].
        model: (m, 2) at the same instants [m].
    """
    pairs = [(robot[:, i] - robot[:, i].mean(), model[:, i] - model[:, i].mean()) for i in range(2)]
    covariance = sum(float(a @ b) for a, b in pairs)
    scale = np.sqrt(sum(float(a @ a) for a, _ in pairs) * sum(float(b @ b) for _, b in pairs))
    return covariance / scale if scale > 0 else float("nan")


def touchdown_spike(speed: np.ndarray, touchdowns: np.ndarray, window: int) -> float:
    """Mean range of the forward speed around touchdowns: the spike it has there [m/s].

    The reduced-order model's body velocity spikes where a foot lands; the paper says that the
    policy does not copy that (Fig. 5).

    Args:
        speed: (m,) [m/s].
        touchdowns: (k,) samples.
        window: samples before and after each.
    """
    parts = [speed[k - window : k + window + 1] for k in touchdowns]
    ranges = [np.ptp(part) for part in parts if len(part) == 2 * window + 1]
    return float(np.mean(ranges)) if ranges else float("nan")
