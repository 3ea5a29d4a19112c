"""Contact of feet with the ground: stances, touchdowns, frequencies."""

from __future__ import annotations

import itertools

import numpy as np

from aslip.errors import ConfigurationError, ShapeError

CONTACT_FORCE = 20.0
"""Force above which a foot is on the ground [N], 6 % of the robot's weight."""

SHORTEST_CONTACT = 0.05
"""Duration below which a contact is a bounce [s]."""

SHORTEST_SWING = 0.11
"""Duration below which an unloaded interval belongs to a stance [s].

Legs of spring-mass walking are unloaded for up to 0.10 s in mid-stance. The shortest swing takes
0.115 s in the authors' published forces and 0.22 s with our policies. Half of the expected swing is
a better limit where it is known."""


def stances(
    force: np.ndarray,
    period: float,
    *,
    contact: float = SHORTEST_CONTACT,
    swing: float = SHORTEST_SWING,
) -> np.ndarray:
    """Stances of one foot that begin and end within the record.

    A foot is on the ground while its vertical force exceeds `CONTACT_FORCE`. Gaps shorter
    than a swing are closed first, then contacts shorter than a stance are dropped.

    Args:
        force: (m,) vertical ground force [N].
        period: time between samples [s].
        contact: shortest stance [s].
        swing: shortest time between two stances [s].

    Returns:
        (k, 2) first sample of each stance, and one past its last.

    Raises:
        ShapeError: `force` is not one-dimensional.
        ConfigurationError: the period is not positive, or a force not finite.
    """
    force = _checked(force, period)
    loaded = merge_short(force > CONTACT_FORCE, round(swing / period), round(contact / period))
    edges = np.diff(loaded.astype(int))
    begins, ends = np.flatnonzero(edges == 1) + 1, np.flatnonzero(edges == -1) + 1
    # stances that begin before the record or end after it have no known length
    ends = ends[ends > begins[0]] if len(begins) else ends[:0]
    begins = begins[: len(ends)]
    return np.stack([begins, ends], axis=1)


def merge_short(flags: np.ndarray, off: int, on: int) -> np.ndarray:
    """Fill inner runs of False shorter than `off`, then clear runs of True shorter than `on`."""
    flags = flags.copy()
    for value, shortest in ((False, off), (True, on)):
        edges = np.flatnonzero(np.diff(flags.astype(int))) + 1
        bounds = np.concatenate([[0], edges, [len(flags)]])
        for start, stop in itertools.pairwise(bounds[1:-1]):
            if flags[start] == value and stop - start < shortest:
                flags[start:stop] = not value
    return flags


def touchdown_times(force: np.ndarray, period: float, swing: float = SHORTEST_SWING) -> np.ndarray:
    """(k,) touchdown times of one foot [s], of stances within the record.

    The force is interpolated linearly between samples, so that the resolution is finer than
    the period.

    Args:
        force: (m,) vertical ground force [N].
        period: time between samples [s].
        swing: shortest swing [s].
    """
    first = stances(force, period, swing=swing)[:, 0]
    before, after = force[first - 1], force[first]
    share = (CONTACT_FORCE - before) / (after - before)
    return (first - 1 + np.clip(share, 0.0, 1.0)) * period


def step_frequency(
    left: np.ndarray, right: np.ndarray, period: float, swing: float = SHORTEST_SWING
) -> float:
    """Footsteps of both feet per second: twice the frequency of strides [Hz].

    From the mean time between touchdowns of the same foot, first to last, so that an uneven gait
    counts as its mean. NaN if neither foot touches down twice.

    Args:
        left: (m,) vertical ground force of the left foot [N].
        right: (m,) vertical ground force of the right foot [N].
        period: time between samples [s].
        swing: shortest swing [s].
    """
    strides, duration = 0, 0.0
    for force in (left, right):
        times = touchdown_times(force, period, swing)
        if len(times) >= 2:
            strides += len(times) - 1
            duration += times[-1] - times[0]
    return 2 * strides / duration if strides else float("nan")


def duty_factor(force: np.ndarray, period: float, swing: float = SHORTEST_SWING) -> float:
    """Share of the stride during which one foot is on the ground; NaN without two touchdowns.

    Args:
        force: (m,) vertical ground force [N].
        period: time between samples [s].
        swing: shortest swing [s].
    """
    found = stances(force, period, swing=swing)
    if len(found) < 2:
        return float("nan")
    strides = np.diff(found[:, 0])
    return float(np.diff(found, axis=1)[:-1, 0].sum() / strides.sum())


def airborne_share(force: np.ndarray, threshold: float = 0.0) -> float:
    """Share of time without ground contact of either foot, aerial phases [0 to 1].

    Walking has none: Alexander, "Optimization and gaits in the locomotion of vertebrates",
    Physiological Reviews 69 (1989). Samples at the rate of the physics show gaps of milliseconds,
    which means over policy steps hide.

    Args:
        force: (m, 2) vertical ground force of both feet [N].
        threshold: largest force of a foot without contact [N].

    Raises:
        ShapeError: `force` is not of two feet, or empty.
        ConfigurationError: a force is not finite.
    """
    return float(_airborne(force, threshold).mean())


def longest_airborne(force: np.ndarray, period: float, threshold: float = 0.0) -> float:
    """Longest uninterrupted time without ground contact of either foot [s]; see `airborne_share`.

    Args:
        force: (m, 2) vertical ground force of both feet [N].
        period: time between samples [s].
        threshold: largest force of a foot without contact [N].
    """
    airborne = np.pad(_airborne(force, threshold).astype(int), 1)
    edges = np.diff(airborne)
    durations = np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)
    return float(durations.max(initial=0) * period)


def _airborne(force: np.ndarray, threshold: float) -> np.ndarray:
    """(m,) true where neither foot has more than a force."""
    force = both_feet(force)
    if not np.isfinite(force).all():
        row = int(np.flatnonzero(~np.isfinite(force).all(axis=1))[0])
        raise ConfigurationError(f"force must be finite, sample {row} is {force[row]}")
    return np.logical_and(*(force <= threshold).T)


def both_feet(force: np.ndarray) -> np.ndarray:
    """Vertical ground force of both feet as an array (m, 2) of doubles.

    Raises:
        ShapeError: `force` is not of two feet, or empty.
    """
    force = np.asarray(force, dtype=np.float64)
    if force.ndim != 2 or force.shape[1] != 2 or not len(force):
        raise ShapeError(f"force must be of both feet, (m, 2), got shape {force.shape}")
    return force


def slip_distance(
    force: np.ndarray, foot: np.ndarray, period: float, swing: float = SHORTEST_SWING
) -> float:
    """Distance that a sole slides over level ground within a stance, mean over stances [m].

    Length of the sole centre's horizontal path while its foot has ground contact; motion within
    gaps of a stance does not count. Reinforcement learning penalises the same speed of feet in
    contact as foot slip: Ji et al., "Concurrent Training of a Control Policy and a State Estimator
    for Dynamic and Robust Legged Locomotion", IEEE RA-L 7 (2022). Rolling over toe or heel moves
    the sole centre, too, by millimetres. NaN without a stance.

    Args:
        force: (m,) vertical ground force of the foot [N].
        foot: (m, 3) its sole centre [m, world], or at least x and y.
        period: time between samples [s].
        swing: shortest swing [s].

    Raises:
        ShapeError: `foot` has another number of samples than `force`.
        ConfigurationError: the period is not positive, or a force not finite.
    """
    found = stances(force, period, swing=swing)
    if foot.ndim != 2 or len(foot) != len(force) or foot.shape[1] < 2:
        raise ShapeError(f"foot must be ({len(force)}, 3) as the force, got {foot.shape}")
    moved = np.linalg.norm(np.diff(foot[:, :2], axis=0), axis=1)
    moved[(force[1:] <= 0) | (force[:-1] <= 0)] = 0.0
    paths = [moved[start : stop - 1].sum() for start, stop in found]
    return float(np.mean(paths)) if paths else float("nan")


def _checked(force: np.ndarray, period: float) -> np.ndarray:
    force = np.asarray(force, dtype=np.float64)
    if force.ndim != 1:
        raise ShapeError(f"force must be of one foot, (m,), got shape {force.shape}")
    if not period > 0:
        raise ConfigurationError(f"period must be positive [s], got {period!r}")
    if not np.isfinite(force).all():
        row = int(np.flatnonzero(~np.isfinite(force))[0])
        raise ConfigurationError(f"force must be finite, sample {row} is {force[row]}")
    return force
