"""Tracking of the commanded speed, and of the reduced-order model's motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SETTLED = 0.1
"""Largest difference from the new command of a settled speed [m/s]."""


@dataclass(frozen=True)
class StepResponse:
    """Response of the speed to a sudden change of command."""

    settling_time: float
    """Time from the change until the stride-averaged speed stays within 0.1 m/s of the command [s];
    infinite if it does not during the last stride."""
    overshoot: float
    """Largest averaged speed beyond the command, in the direction of the change [m/s]."""
    steady_error: float
    """Mean speed of the last stride minus the command [m/s]."""


def stride_average(signal: np.ndarray, stride: float, period: float) -> np.ndarray:
    """Remove the oscillation within strides: centred moving mean over the duration of one.

    At the ends the signal is continued by its mirror image.

    Args:
        signal: (m, ...) with time first.
        stride: duration of a stride [s].
        period: time between samples [s].
    """
    from scipy.ndimage import uniform_filter1d  # slow to import

    length = max(round(stride / period), 1)
    return uniform_filter1d(np.asarray(signal, dtype=np.float64), length, axis=0, mode="reflect")


def step_response(
    speed: np.ndarray, before: float, command: float, stride: float, period: float
) -> StepResponse:
    """Measure the response to one change of command.

    Args:
        speed: (m,) forward speed at the ends of the steps after the change, until the next [m/s].
        before: command before the change [m/s].
        command: command after it [m/s].
        stride: duration to average over [s].
        period: time between samples [s].
    """
    length = max(round(stride / period), 1)
    # trailing means, which cannot settle before the speed does
    total = np.cumsum(np.concatenate([np.full(length, before), speed]))
    averaged = (total[length:] - total[:-length]) / length
    error = averaged - command
    off = np.flatnonzero(np.abs(error) > SETTLED)
    time = 0.0
    if len(off):
        last = off[-1]
        settled = last + length < len(error)
        time = (last + 1 + _crossing(error[last : last + 2])) * period if settled else np.inf
    beyond = np.sign(command - before) * (averaged - command)
    return StepResponse(
        float(time),
        max(float(beyond.max()), 0.0),
        float(np.mean(speed[-length:]) - command),
    )


def _crossing(error: np.ndarray) -> float:
    """Instant at which an error (2,) crosses `SETTLED`, in steps after the first."""
    return float((abs(error[0]) - SETTLED) / abs(error[1] - error[0]))


def root_mean_square(error: np.ndarray) -> np.ndarray | float:
    """Root mean square of (m, ...) errors over time."""
    return np.sqrt(np.mean(np.square(error), axis=0))


def leg_length_correlation(robot: np.ndarray, model: np.ndarray) -> float:
    """Pearson's correlation of leg lengths, robot and reduced-order model.

    Leg length is the distance from body to foot. The paper finds "changes in leg length directly
    corresponding" to the model's (Sec. V-B). NaN if a length is constant.

    Args:
        robot: (m, 2) lengths of left and right leg [m].
        model: (m, 2) at the same instants [m].
    """
    pairs = [(robot[:, i] - robot[:, i].mean(), model[:, i] - model[:, i].mean()) for i in range(2)]
    covariance = sum(float(a @ b) for a, b in pairs)
    scale = np.sqrt(sum(float(a @ a) for a, _ in pairs) * sum(float(b @ b) for _, b in pairs))
    return covariance / scale if scale > 0 else float("nan")


def touchdown_spike(speed: np.ndarray, touchdowns: np.ndarray, window: int) -> float:
    """Mean range of the forward speed around touchdowns [m/s].

    The reduced-order model's body velocity spikes where a foot lands; the paper says that the
    policy does not copy that (Fig. 5).

    Args:
        speed: (m,) forward speed [m/s].
        touchdowns: (k,) sample of each touchdown.
        window: number of samples before and after each.
    """
    parts = [speed[k - window : k + window + 1] for k in touchdowns]
    ranges = [np.ptp(part) for part in parts if len(part) == 2 * window + 1]
    return float(np.mean(ranges)) if ranges else float("nan")
