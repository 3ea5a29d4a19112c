"""Region of commands that a table covers: a box, or a convex region inside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aslip.errors import ConfigurationError

_ROUNDING = 1e-9  # of a command, relative to the size of the region
_LISTED = 24  # commands in an error message
_LINEAR_ROUNDS = 3  # rings of missing points around a region that its cells can reach


def hull_gauge(commands: np.ndarray, missing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Gauge of the convex hull of commands.

    .. math:: \mathbf c \text{ is inside} \iff \max_i \mathbf n_i (\mathbf c - \mathbf c_0) \le 1

    The centre is the zero command if that is inside, else the mean of the commands. Moving a
    command towards the zero command slows the robot down and keeps the curvature of its path.

    Args:
        commands: (n, c) points of a grid, along axes of two or more values.
        missing: (n,) True at points without a motion.

    Returns:
        (h, c) normals n and (c,) centre.

    Raises:
        ConfigurationError: the commands with motions span no volume, or a command without a motion
            is among them.
    """
    solved = commands[~missing]
    planes = _hull_planes(solved)
    normals, offsets = planes[:, :-1], planes[:, -1]
    inside = inside_hull(commands, ~missing)
    if inside.any():
        raise ConfigurationError(
            "the region of a library must be convex: a motion is missing at"
            f" {commands[inside][0].tolist()}, in the middle of others"
        )
    origin = np.zeros(commands.shape[1])
    centre = origin if (offsets < -_ROUNDING).all() else solved.mean(axis=0)
    room = -(normals @ centre + offsets)
    return normals / room[:, None], centre


def inside_hull(commands: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Mask (n,) of the commands that are not kept, but in the convex hull of those that are.

    Args:
        commands: (n, c) commands.
        kept: (n,) True at commands of the hull.

    Raises:
        ConfigurationError: the commands that are kept span no volume.
    """
    planes = _hull_planes(commands[kept])
    return (commands @ planes[:, :-1].T + planes[:, -1] <= _ROUNDING).all(axis=1) & ~kept


def _hull_planes(commands: np.ndarray) -> np.ndarray:
    """Normals and offsets (h, c + 1) of the facets of a convex hull."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return np.unique(ConvexHull(commands).equations.round(12), axis=0)
    except QhullError as error:
        raise ConfigurationError(
            f"commands of motions must span the grid, got {listed(commands.tolist())}"
        ) from error


def extrapolate(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Fill the entries of missing points of a grid, so that its cells can be interpolated.

    Linear from two neighbours in a row, averaged over directions; far from the region the value of
    a neighbour.

    Args:
        values: (*g, ...) values; those at missing points are ignored.
        present: (*g,) True at points with a value.
    """
    if present.all():
        return values
    filled, known, rounds = np.array(values), present.copy(), 0
    filled[~known] = 0
    while not known.all():
        found = _neighbours(filled, known, linear=rounds < _LINEAR_ROUNDS)
        if found is None:
            found = _neighbours(filled, known, linear=False)
        assert found is not None  # a known point has an unknown neighbour
        total, count = found
        new = count > 0
        filled[new] = total[new] / count[new].reshape(-1, *(1,) * (values.ndim - known.ndim))
        known |= new
        rounds += 1
    return filled


def _neighbours(
    values: np.ndarray, known: np.ndarray, *, linear: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    """Sum and number of the guesses for each unknown point; None without any."""
    total, count = np.zeros_like(values), np.zeros(known.shape, dtype=int)
    for axis in range(known.ndim):
        for step in (1, -1):
            near, far = (_shifted(known, axis, k * step) for k in (1, 2))
            usable = ~known & near & (far | (not linear))
            guess = _shifted(values, axis, step)
            if linear:
                guess = 2 * guess - _shifted(values, axis, 2 * step)
            total[usable] += guess[usable]
            count += usable
    return (total, count) if count.any() else None


def _shifted(values: np.ndarray, axis: int, step: int) -> np.ndarray:
    """Values of the neighbours `step` places ahead along an axis; 0 beyond the grid."""
    moved, rows = np.zeros_like(values), np.moveaxis(values, axis, 0)
    target, size = np.moveaxis(moved, axis, 0), len(rows)
    if abs(step) < size:
        target[max(0, -step) : size - max(0, step)] = rows[max(0, step) : size + min(0, step)]
    return moved


def listed(commands: Sequence[Sequence[float]]) -> str:
    """First commands, and the number of all if there are more."""
    if len(commands) <= _LISTED:
        return str(list(commands))
    return f"{list(commands[:_LISTED])} and {len(commands) - _LISTED} more"


def describe(axes: Sequence[np.ndarray]) -> str:
    """Range of each axis with its name and unit."""
    return ", ".join(
        f"{name} {axis[0]:g} to {axis[-1]:g} {unit}"
        for (name, unit), axis in zip(COMMANDS, axes, strict=False)
    )


COMMANDS = (("forward speed", "m/s"), ("sideways speed", "m/s"), ("yaw rate", "rad/s"))
"""Name and unit of each axis of a command."""
