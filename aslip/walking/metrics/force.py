"""Ground force over a stance: humps and the dip between them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from aslip.errors import ConfigurationError
from aslip.walking.metrics.contact import CONTACT_FORCE, SHORTEST_SWING, stances

SMOOTHING = 0.03
"""Length of the moving average that is applied twice before humps are counted [s]."""

IMPACT = 0.05
"""Duration from touchdown within which a force is an impact [s]."""

NEAR_LIMIT = 0.95
"""Ratio of used to available friction from which a foot counts as at its limit."""

PROMINENCE = 25.0
"""Least rise of a hump above the dips beside it [N]."""


@dataclass(frozen=True)
class ForceProfile:
    """Vertical force of one foot over a stance, means over stances."""

    humps: float
    """Number of humps."""
    dip_ratio: float
    """Lowest force between the outer humps over the lower of them; 1 for a single hump."""
    duration: float
    """Duration of a stance [s]."""
    impulse: float
    """Impulse of a stance [N s]."""
    peak: float
    """Largest force, unsmoothed: the impact [N]."""
    stances: int
    """Number of stances."""


def force_profile(force: np.ndarray, period: float) -> ForceProfile:
    """Describe the ground force of one foot.

    Args:
        force: (m,) vertical ground force [N], at 200 Hz or more.
        period: time between samples [s].
    """
    rows = []
    for start, stop in stances(force, period):
        part = force[start:stop]
        found = humps(part, period)
        rows.append(
            (
                len(found),
                dip_ratio(part, period),
                (stop - start) * period,
                part.sum() * period,
                part.max(),
            )
        )
    means = np.mean(rows, axis=0) if rows else np.full(5, np.nan)
    return ForceProfile(*map(float, means), stances=len(rows))


def humps(force: np.ndarray, period: float) -> np.ndarray:
    """(k,) samples of the humps of one stance.

    Local maxima with a prominence of at least 25 N after two passes of a moving average of 30 ms,
    which removes the impact. Outside the stance the force counts as zero.

    Args:
        force: (m,) vertical ground force of a stance [N].
        period: time between samples [s].
    """
    smooth, margin = _smoothed(force, period)
    return _peaks(smooth) - margin


def dip_ratio(force: np.ndarray, period: float) -> float:
    """Lowest force of a stance between its outer humps, over that of the lower hump.

    0 if the foot is unloaded in between, 1 for a single hump.

    Args:
        force: (m,) vertical ground force of a stance [N].
        period: time between samples [s].
    """
    smooth, _ = _smoothed(force, period)
    peaks = _peaks(smooth)
    if len(peaks) < 2:
        return 1.0
    outer = smooth[peaks[[0, -1]]].min()
    return float(smooth[peaks[0] : peaks[-1] + 1].min() / outer)


def touchdown_impact(
    force: np.ndarray, period: float, weight: float, swing: float = SHORTEST_SWING
) -> float:
    """Largest vertical force of a foot in the first 50 ms of a stance over body weight.

    Mean over stances; NaN without one. Biomechanics calls forces impacts that have their maximum
    within 50 ms from the first contact: Nigg, Cole and Brueggemann, "Impact Forces during Heel-Toe
    Running", Journal of Applied Biomechanics 11 (1995).

    Args:
        force: (m,) vertical ground force of the foot [N], at 1 kHz or more.
        period: time between samples [s].
        weight: weight of the robot [N].
        swing: shortest swing [s].

    Raises:
        ShapeError: `force` is not one-dimensional.
        ConfigurationError: period or weight is not positive, or a force not finite.
    """
    _check_weight(weight)
    length = max(round(IMPACT / period), 1)
    found = [
        force[start : min(start + length, stop)].max()
        for start, stop in stances(force, period, swing=swing)
    ]
    return float(np.mean(found) / weight) if found else float("nan")


def friction_limit_share(force: np.ndarray, friction: float) -> float:
    """Share of time in which a loaded foot uses more than 95 % of the friction of the floor.

    Args:
        force: (m, 2, 3) ground force of both feet [N], z up from a level floor.
        friction: coefficient of sliding friction.

    Raises:
        ConfigurationError: the friction is not positive.
    """
    if not friction > 0:
        raise ConfigurationError(f"friction must be positive, got {friction}")
    tangential, normal = np.linalg.norm(force[..., :2], axis=-1), force[..., 2]
    used = (normal > CONTACT_FORCE) & (tangential > NEAR_LIMIT * friction * normal)
    return float(used.any(axis=-1).mean())


def largest_force(force: np.ndarray, weight: float) -> float:
    """Largest vertical force of a single foot over body weight, impacts included.

    Args:
        force: (m, 2) vertical ground force of both feet [N], at 1 kHz or more.
        weight: weight of the robot [N].

    Raises:
        ConfigurationError: the weight is not positive.
    """
    _check_weight(weight)
    return float(np.max(force) / weight)


def _check_weight(weight: float) -> None:
    if not weight > 0:
        raise ConfigurationError(f"weight must be positive [N], got {weight!r}")


def mean_over_strides(
    force: np.ndarray, starts: np.ndarray, samples: int = 200
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation over strides, each resampled to the same length.

    Args:
        force: (m, ...) any signal.
        starts: (k,) first sample of each stride; the last only ends the one before.
        samples: number of samples of a resampled stride.

    Returns:
        (samples, ...) each.
    """
    strides = []
    for start, stop in itertools.pairwise(starts):
        at = start + (stop - start) * np.arange(samples) / samples
        low = np.floor(at).astype(int)
        high = np.minimum(low + 1, len(force) - 1)
        share = (at - low).reshape(-1, *[1] * (force.ndim - 1))
        strides.append((1 - share) * force[low] + share * force[high])
    return np.mean(strides, axis=0), np.std(strides, axis=0)


def _peaks(smooth: np.ndarray) -> np.ndarray:
    """Samples of the prominent local maxima."""
    from scipy.signal import find_peaks  # slow to import

    return find_peaks(smooth, prominence=PROMINENCE)[0]


def _smoothed(force: np.ndarray, period: float) -> tuple[np.ndarray, int]:
    """Stance padded with zeros and smoothed, and the number of samples put in front."""
    from scipy.ndimage import uniform_filter1d  # slow to import

    length = max(round(SMOOTHING / period), 1)
    padded = np.pad(np.asarray(force, dtype=np.float64), 2 * length)
    for _ in range(2):
        padded = uniform_filter1d(padded, length, mode="constant")
    return padded, 2 * length
