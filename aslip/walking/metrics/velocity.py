"""How a walk follows its commanded speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

SETTLED = 0.1
"""A speed within so much of the new command has settled [m/s]."""


@dataclass(frozen=True)
class StepResponse:
    """What a sudden change of command does to the speed."""

    settling_time: float
    """From the change until the stride-averaged speed stays within 0.1 m/s of the command [s];
    infinite if it does not for the last stride at least."""
    overshoot: float
    """How far the averaged speed goes beyond the command, in the direction of the change [m/s]."""
    steady_error: float
    """Mean speed of the last stride minus the command [m/s]."""


def stride_average(signal: np.ndarray, stride: float, period: float) -> np.ndarray:
    """A signal without the oscillation of a stride: centred moving mean over its duration.

    At the ends the signal is continued by its mirror image.

    Args:
        signal: (m, ...) with time first.
        stride: [s].
        period: between samples [s].
    """
    length = max(round(stride / period), 1)
    return uniform_filter1d(np.asarray(signal, dtype=np.float64), length, axis=0, mode="reflect")


def step_response(
    speed: np.ndarray, before: float, command: float, stride: float, period: float
) -> StepResponse:
    """Describe the answer to one change of command.

    Args:
        speed: (m,) forward speed at the ends of the steps after the change, until the next [m/s].
        before: command before the change [m/s].
        command: and after [m/s].
        stride: duration to average over [s].
        period: between samples [s].
    """
    length = max(round(stride / period), 1)
    # trailing means: what has been averaged is past, so settling is not seen before it happens
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
    """When an error (2,) that settles crosses the limit, in steps after the first."""
    return float((abs(error[0]) - SETTLED) / abs(error[1] - error[0]))
