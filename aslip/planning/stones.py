"""Possible footholds: convex polygons with heights, as half-planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from aslip.base.arrays import Array, namespace
from aslip.errors import ConfigurationError

# sine of the angle up to which a corner counts as straight, and least length of an edge [m]
_STRAIGHT, _SHORT = 1e-9, 1e-6
# where stones are put that do not exist [m]
_FAR_AWAY = 1e3
# sweeps of projections onto the edges; one is exact on rectangles
_SWEEPS = 2
# share of a stone's half width that is left if it is smaller than the foot
_LEFT = 0.1
# distance from the middle of a stone, of which later steps leave a share [m]
_RESERVED = 0.1


@dataclass(frozen=True, eq=False)
class Stones:
    """m stones of each of n robots: the points p with normals p <= offsets.

    Stones with fewer edges than others repeat one; robots with fewer stones have `present` False.
    """

    normals: Array
    """(n, m, e, 2) outward unit normals of the edges."""
    offsets: Array
    """(n, m, e) distances of the edges from the origin [m]."""
    corners: Array
    """(n, m, e, 2) corners at the edges' beginnings [m]."""
    centres: Array
    """(n, m, 2) means of the corners [m]."""
    heights: Array
    """(n, m) heights of the tops [m]."""
    present: Array
    """(n, m) bool."""

    @classmethod
    def of(cls, polygons: Sequence[np.ndarray], heights: Sequence[float]) -> Stones:
        """Stones of one robot, n = 1.

        Args:
            polygons: corners (k, 2) of each, in order either way [m].
            heights: heights of the tops [m].

        Raises:
            ConfigurationError: there is no stone, the counts differ, a number is not finite, or a
                polygon has fewer than three corners or is not convex.
        """
        if not len(polygons) or len(polygons) != len(heights):
            raise ConfigurationError(
                "stones need as many heights as polygons, and one or more, got"
                f" {len(polygons)} polygons and {len(heights)} heights"
            )
        if not np.isfinite(heights).all():
            raise ConfigurationError(f"heights of stones must be finite, got {list(heights)}")
        corners = [_checked(i, polygon) for i, polygon in enumerate(polygons)]
        most = max(map(len, corners))
        # a corner that is repeated gives an edge again
        padded = [np.concatenate([c, np.repeat(c[-1:], most - len(c), axis=0)]) for c in corners]
        normals = np.empty((1, len(corners), most, 2))
        for row, given in zip(normals[0], corners, strict=True):
            along = np.roll(given, -1, axis=0) - given
            edges = np.stack([along[:, 1], -along[:, 0]], axis=1)
            edges /= np.linalg.norm(edges, axis=1, keepdims=True)
            row[: len(given)], row[len(given) :] = edges, edges[-1]
        offsets = np.einsum("nmek,mek->nme", normals, np.array(padded))
        centres = np.array([[given.mean(axis=0) for given in corners]])
        tops = np.asarray(heights, dtype=float)[None]
        return cls(
            normals, offsets, np.array([padded]), centres, tops, np.ones(tops.shape, dtype=bool)
        )

    @classmethod
    def from_corners(cls, corners: Array, heights: Array) -> Stones:
        """Stones of n robots.

        Args:
            corners: (n, m, e, 2) corners of convex polygons, counter-clockwise, NaN where is no
                stone [m].
            heights: (n, m) heights of the tops [m].
        """
        xp = namespace(corners)
        present = xp.isfinite(corners).all(-1).all(-1)
        corners = xp.where(
            present[..., None, None], corners, _FAR_AWAY + 0 * present[..., None, None]
        )
        along = xp.roll(corners, -1, 2) - corners
        length = ((along**2).sum(-1) + _SHORT**2) ** 0.5
        normals = xp.stack([along[..., 1], -along[..., 0]], -1) / length[..., None]
        return cls(
            normals=normals,
            offsets=(normals * corners).sum(-1),
            corners=corners,
            centres=corners.mean(2),
            heights=xp.where(present, heights, 0 * length[..., 0]),
            present=present,
        )

    def pick(self, index: Array) -> Stones:
        """Stones (n, k) by index (n, k)."""
        rows = namespace(index).arange(len(index), device=index.device)[:, None]
        return Stones(*(getattr(self, f.name)[rows, index] for f in fields(self)))

    def only(self, index: int) -> Stones:
        """One stone of each robot, m = 1."""
        return Stones(*(getattr(self, f.name)[:, index : index + 1] for f in fields(self)))

    def shrunk(
        self, heading: Array, half_length: float, margin: float, share: float | np.ndarray = 1.0
    ) -> Array:
        """Offsets (n, s, m, e) of the places where a whole foot stands on a stone.

        A foot is a segment. On stones that are too small for it, its centre may be near theirs.

        Args:
            heading: (n, s) directions of the toes at s steps [rad].
            half_length: half the length of the segment [m].
            margin: distance that is left to the edges [m].
            share: share of what is left, of 0.1 m at most to either side, that is used, one number
                or (s, 1, 1) [-].
        """
        xp = namespace(self.offsets)
        toes = xp.stack([xp.cos(heading), xp.sin(heading)], -1)
        along = xp.einsum("nmek,nsk->nsme", self.normals, toes)
        middle = (self.normals * self.centres[..., None, :]).sum(-1)
        inside = (self.offsets - middle)[:, None]
        free = xp.maximum(inside - half_length * abs(along) - margin, _LEFT * inside)
        return middle[:, None] + free - (1 - share) * free.clip(None, _RESERVED)

    def height(self, stone: Array, floor: Array) -> Array:
        """Heights (n,) of stones by index (n,); that of the floor (n,) for index -1."""
        xp = namespace(self.heights)
        rows = xp.arange(len(stone), device=self.heights.device)
        return xp.where(stone >= 0, self.heights[rows, stone], floor)


def nearest(points: Array, normals: Array, offsets: Array) -> Array:
    """Points (*b, 2) of polygons nearest to points (*b, 2), exact on rectangles [m].

    Args:
        points: (*b, 2) any points [m].
        normals: (*b, e, 2) outward unit normals of the edges.
        offsets: (*b, e) distances of the edges from the origin [m].
    """
    for edge in [*range(offsets.shape[-1])] * _SWEEPS:
        normal = normals[..., edge, :]
        beyond = ((normal * points).sum(-1) - offsets[..., edge]).clip(0.0)
        points = points - beyond[..., None] * normal
    return points


def _checked(index: int, polygon: np.ndarray) -> np.ndarray:
    """Corners (k, 2) of a convex polygon, counter-clockwise."""
    corners = np.asarray(polygon, dtype=float)
    if corners.ndim != 2 or corners.shape[1:] != (2,) or len(corners) < 3:
        raise ConfigurationError(
            f"stone {index} must have three or more corners (x, y), got shape {corners.shape}"
        )
    if not np.isfinite(corners).all():
        raise ConfigurationError(f"stone {index} must be finite, got {corners.tolist()}")
    along = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(along, axis=1)
    if length.min() < _SHORT:
        raise ConfigurationError(f"stone {index} has two equal corners: {corners.tolist()}")
    along /= length[:, None]
    after = np.roll(along, -1, axis=0)
    turns = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0]
    total = np.arctan2(turns, (along * after).sum(axis=1)).sum()
    # once around: a star turns to one side, too, and a bow tie not at all
    once = abs(abs(total) - 2 * np.pi) < 1.0
    if not once or (turns * np.sign(total) < -_STRAIGHT).any():
        raise ConfigurationError(f"stone {index} must be convex, got {corners.tolist()}")
    return corners if total > 0 else corners[::-1]
