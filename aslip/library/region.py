"""Region of commands that a table covers: a box, or a convex region inside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, product

import numpy as np

from aslip.errors import ConfigurationError

_ROUNDING = 1e-9  # of a command, relative to the size of the region
_REACH = 1e-6  # of a look-up beyond the border, relative to the size of the region
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


def reached_corners(
    axes: Sequence[np.ndarray], normals: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """Mask (*g,) of the corners of all cells of a grid that a convex region may reach into.

    Cells that the region does not reach, but that no facet separates from it, count as well.

    Args:
        axes: two or more coordinates along each axis.
        normals: (h, c) normals of the region, see `hull_gauge`.
        centre: (c,) centre.
    """
    nearest = np.zeros((len(normals), *(1 for _ in axes)))
    for i, axis in enumerate(axes):
        ends = np.multiply.outer(normals[:, i], axis - centre[i])
        shape = [len(normals), *(1 for _ in axes)]
        shape[i + 1] = len(axis) - 1
        nearest = nearest + np.minimum(ends[:, :-1], ends[:, 1:]).reshape(shape)
    cells = (nearest <= 1 + _REACH).all(axis=0)
    corners = np.zeros([len(axis) for axis in axes], dtype=bool)
    for steps in product((0, 1), repeat=len(axes)):
        corners[tuple(slice(s, s + n) for s, n in zip(steps, cells.shape, strict=True))] |= cells
    return corners


def _hull_planes(commands: np.ndarray) -> np.ndarray:
    """Normals and offsets (h, c + 1) of the facets of a convex hull."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    if commands.shape[1] == 1 and len(commands):
        return np.array([[-1.0, commands.min()], [1.0, -commands.max()]])
    try:
        return np.unique(ConvexHull(commands).equations.round(12), axis=0)
    except (QhullError, ValueError) as error:
        raise ConfigurationError(
            f"commands of motions must span the grid, got {listed(commands.tolist())}"
        ) from error


def extrapolate(values: np.ndarray, present: np.ndarray, axes: Sequence[np.ndarray]) -> np.ndarray:
    """Fill the entries of missing points of a grid, so that its cells can be interpolated.

    The last missing corner of a cell makes the cell's mixed difference over all axes zero. A corner
    of a cell that lacks several is the mean of linear extrapolations along the axes and of
    parallelograms. A corner far from the region is the mean of its neighbours.

    Args:
        values: (*g, ...) values; those at missing points are ignored.
        present: (*g,) True at points with a value.
        axes: coordinates along each axis of the grid.
    """
    if present.all():
        return values
    filled, known, rounds = np.array(values), present.copy(), 0
    filled[~known] = 0
    while not known.all():
        unknown = [tuple(at) for at in np.argwhere(~known).tolist()]
        near = rounds < _LINEAR_ROUNDS
        found = {at: _guess(filled, known, axes, at, near=near) for at in unknown}
        if all(guess is None for guess in found.values()):
            found = {at: _guess(filled, known, axes, at, near=False) for at in unknown}
        for at, guess in found.items():
            if guess is not None:
                filled[at], known[at] = guess, True
        rounds += 1
    return filled


Place = tuple[int, ...]
"""Place on a grid."""


def _guess(
    values: np.ndarray, known: np.ndarray, axes: Sequence[np.ndarray], at: Place, *, near: bool
) -> np.ndarray | None:
    """Guess for an unknown point from known ones; None where there are too few."""
    wide = [i for i, size in enumerate(known.shape) if size > 1]
    if not near:
        return _mean(_corner(values, known, at, {i: s}) for i in wide for s in (1, -1))
    if len(wide) > 1:
        whole = _mean(_corner(values, known, at, steps) for steps in _directions(wide))
        if whole is not None:
            return whole
    pairs = [steps for pair in combinations(wide, 2) for steps in _directions(pair)]
    faces = _mean(_corner(values, known, at, steps) for steps in pairs)
    lines = _mean(_line(values, known, axes, at, i, s) for i in wide for s in (1, -1))
    return _mean([faces, lines])


def _directions(wide: Sequence[int]) -> list[dict[int, int]]:
    """Steps of 1 or -1 along axes, in all combinations."""
    return [dict(zip(wide, signs, strict=True)) for signs in product((1, -1), repeat=len(wide))]


def _corner(
    values: np.ndarray, known: np.ndarray, at: Place, steps: Mapping[int, int]
) -> np.ndarray | None:
    """Corner of a box from its other corners, with a mixed difference of zero."""
    total = np.zeros_like(values[at])
    for used in list(product((0, 1), repeat=len(steps)))[1:]:
        place = list(at)
        for (axis, step), use in zip(steps.items(), used, strict=True):
            place[axis] += step * use
        if not _is_known(known, place):
            return None
        total += (-1) ** (sum(used) + 1) * values[tuple(place)]
    return total


def _line(
    values: np.ndarray,
    known: np.ndarray,
    axes: Sequence[np.ndarray],
    at: Place,
    axis: int,
    step: int,
) -> np.ndarray | None:
    """Value on the line through two neighbours in a row."""
    one, two = list(at), list(at)
    one[axis] += step
    two[axis] += 2 * step
    if not (_is_known(known, one) and _is_known(known, two)):
        return None
    here, near, far = (axes[axis][place[axis]] for place in (at, one, two))
    first, second = values[tuple(one)], values[tuple(two)]
    return first + (first - second) * ((here - near) / (near - far))


def _is_known(known: np.ndarray, place: Sequence[int]) -> bool:
    inside = all(0 <= i < size for i, size in zip(place, known.shape, strict=True))
    return inside and bool(known[tuple(place)])


def _mean(guesses: Iterable[np.ndarray | None]) -> np.ndarray | None:
    """Mean of the guesses that exist."""
    found = [guess for guess in guesses if guess is not None]
    return sum(found[1:], found[0]) / len(found) if found else None


def listed(commands: Sequence[Sequence[float]]) -> str:
    """First commands, and the number of the others."""
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
