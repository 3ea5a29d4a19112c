"""Stones of n robots, and the fields of the MuJoCo model that depend on them.

Robots of one batch may have different courses: the model has as many boxes as the longest course
has stones, and each robot has its own places and sizes of them. A robot's floor is `FLOOR_DEPTH`
below its lowest stone, or at height zero if it has no stones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np

from aslip.base.arrays import Array, copied, is_numpy, namespace
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot.model import AWAY, PRISM_GEOM, STONE_GEOM, Prism, ground_geoms, load_model
from aslip.sim.course import MOST_STONES, STONE, Course
from aslip.sim.dynamics import write_fields

FLOOR_DEPTH: Final = 1.0
"""Depth of the floor below a robot's lowest stone [m]; stones are pillars on it."""
_FIELDS = ("geom_pos", "geom_quat", "geom_size", "geom_aabb", "geom_rbound")


class PlacedStones:
    """Stones of n robots, none at first.

    Args:
        num: number of robots n.
        model: compiled model.
        arranged: what makes numbers arrays of the simulator's kind.
    """

    def __init__(
        self,
        num: int,
        model: mujoco.MjModel,
        arranged: Callable[[np.ndarray], Array] = np.asarray,
    ) -> None:
        self._arranged = arranged
        self.rows = arranged(np.full((num, 0, len(STONE)), np.nan))
        """(n, s, 6) stones by the columns of `aslip.sim.course.STONE`; NaN where is none."""
        self._prisms_of: list[tuple[Prism, ...]] = [()] * num
        self.prisms: tuple[Prism, ...] = ()
        """Stones that are not rectangles, of all robots together."""
        self.use_model(model)

    def use_model(self, model: mujoco.MjModel) -> None:
        """Take default fields from a model with all stones."""
        self._default = {name: self._arranged(getattr(model, name).copy()) for name in _FIELDS}
        self._floor = model.geom("floor").id
        self._boxes = self._arranged(ground_geoms(model, STONE_GEOM))
        self._others = ground_geoms(model, PRISM_GEOM)
        self._modelled = self.prisms

    @property
    def fit(self) -> bool:
        """Whether the model has all stones."""
        return self.rows.shape[1] <= len(self._boxes) and {*self.prisms} <= {*self._modelled}

    def place(self, ids: Array, courses: Sequence[Course | None]) -> None:
        """Give (k,) robots k courses; None takes a robot's stones away."""
        longest = max((len(course.stones) for course in courses if course), default=0)
        rows = np.full((len(ids), longest, len(STONE)), np.nan)
        for row, course in zip(rows, courses, strict=True):
            if course:
                row[: len(course.stones)] = course.stones
        self._place(ids, self._arranged(rows), [_prisms(course) for course in courses])

    def place_rows(self, ids: Array, rows: Array) -> None:
        """Give (k,) robots stones (k, s, 6), NaN where is none.

        Raises:
            ShapeError: the stones have another shape.
            ConfigurationError: a stone has numbers and NaN, or no size; all stay as they are.
        """
        shape = tuple(rows.shape)
        if len(shape) != 3 or shape[::2] != (len(ids), len(STONE)) or shape[1] > MOST_STONES:
            raise ShapeError(
                f"stones must have shape ({len(ids)}, up to {MOST_STONES}, {len(STONE)}), got"
                f" {shape}"
            )
        xp = namespace(rows)
        good = xp.isnan(rows).all(-1) | (xp.isfinite(rows).all(-1) & (rows[..., 4:] > 0).all(-1))
        if not good.all():
            raise ConfigurationError(
                "stones must be NaN, or finite with length and width above 0, got"
                f" {rows[~good][0].tolist()}"
            )
        self._place(ids, rows if is_numpy(rows) else rows.double(), [()] * len(ids))

    def _place(self, ids: Array, rows: Array, prisms: Sequence[tuple[Prism, ...]]) -> None:
        num, width, _ = self.rows.shape
        if rows.shape[1] > width:
            wider = self._arranged(np.full((num, rows.shape[1], len(STONE)), np.nan))
            wider[:, :width] = self.rows
            self.rows = wider
        self.rows[ids] = np.nan
        self.rows[ids, : rows.shape[1]] = rows
        if self.prisms or any(prisms):
            for i, own in zip(ids.tolist(), prisms, strict=True):
                self._prisms_of[i] = own
            self.prisms = tuple(dict.fromkeys(p for own in self._prisms_of for p in own))

    def fields(self, ids: Array) -> dict[str, Array]:
        """Field of the model -> (k, ...), for (k,) robots."""
        rows = self.rows[ids]
        xp = namespace(rows)
        fields = {
            name: copied(xp.broadcast_to(value, (len(ids), *value.shape)))
            for name, value in self._default.items()
        }
        if rows.shape[1]:
            x, y, z, yaw, length, width = (rows[..., i] for i in range(len(STONE)))
            lowest = xp.amin(xp.where(xp.isnan(z), np.inf, z), axis=1)
            floor = xp.where(xp.isinf(lowest), 0.0, lowest - FLOOR_DEPTH)
            fields["geom_pos"][:, self._floor, 2] = floor
            half = [length / 2, width / 2, (z - floor[:, None]) / 2]
            none = xp.zeros_like(z)
            values = {
                "geom_pos": [x, y, z - half[2]],
                "geom_quat": [xp.cos(yaw / 2), none, none, xp.sin(yaw / 2)],
                "geom_size": half,
                "geom_aabb": [none, none, none, *half],
            }
            boxes, there = self._boxes[: rows.shape[1]], xp.isfinite(width)
            for name, parts in values.items():
                given = xp.where(there[..., None], xp.stack(parts, -1), fields[name][:, boxes])
                fields[name][:, boxes] = given
            radius = xp.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
            fields["geom_rbound"][:, boxes] = xp.where(
                there, radius, fields["geom_rbound"][:, boxes]
            )
        for geom, prism in zip(self._others, self._modelled, strict=True):
            lacking = [prism not in self._prisms_of[i] for i in ids.tolist()]
            fields["geom_pos"][:, geom, 2] += AWAY * self._arranged(np.array(lacking, dtype=float))
        return fields


@lru_cache(maxsize=64)
def _prisms(course: Course | None) -> tuple[Prism, ...]:
    """Stones of a course that are not rectangles."""
    if course is None:
        return ()
    bottom = float(course.stones[:, 2].min()) - FLOOR_DEPTH
    return tuple(
        Prism(tuple(map(tuple, corners.tolist())), (bottom, float(course.stones[i, 2])))
        for i, corners in course.polygons.items()
    )


def course_model(course: Course, *, visual: bool = True) -> mujoco.MjModel:
    """Model of a robot on a course, to draw it or to simulate it alone; see `load_model`."""
    prisms = _prisms(course)
    model = load_model(visual=visual, stones=len(course.stones), prisms=prisms)
    stones = PlacedStones(1, model)
    stones.place(np.zeros(1, dtype=int), [course])
    stones.use_model(model)
    fields = stones.fields(np.zeros(1, dtype=int))
    write_fields(model, {name: rows[0] for name, rows in fields.items()})
    return model
