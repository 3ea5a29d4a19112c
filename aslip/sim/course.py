"""Courses: stones that a robot walks over, as data, from patterns, a seed or a file.

A course is in the world's frame. Robots start above its origin, facing x, on the first stone, whose
top is at height zero. Between the stones is nothing; `SimulatedEnv.set_course` makes them physical.
A stone is a row of six numbers, `STONE`. In courses made here, feet alternate, the left one first,
between a platform at the start and one at the goal.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from aslip.base.arrays import Array, namespace
from aslip.base.assets import user_path
from aslip.base.checks import check_count, check_number
from aslip.errors import ConfigurationError, FileDamagedError, ShapeError, UnknownNameError

STONE: Final = ("x", "y", "z", "yaw", "length", "width")
"""Numbers of a rectangular stone: centre of its top [m], yaw [rad], length along its own x and
width along its own y [m]. Of another convex polygon, the last three are NaN."""
STONE_SIZE: Final = 0.2
"""Side of a square stone [m]; Cassie's foot is 0.16 m long."""
LEAST_GAP: Final = 0.02
"""Gap that is left between stones of random lengths of steps [m]."""
LARGEST_GAP: Final = 0.6
"""Largest gap to an earlier stone [m], along the normal of an edge; the longest steps of the gait
library are 0.8 m."""
LARGEST_RISE: Final = 0.3
"""Largest difference of heights of two stones in a row [m]."""
MOST_STONES: Final = 200
"""Largest number of stones of a course."""
# standing feet, with a margin [m]
_FEET = np.array([[-0.1, -0.17], [0.1, -0.17], [0.1, 0.17], [-0.1, 0.17]])
_FARTHEST = 1e3
# lateral distance of feet, and the start's and goal's platforms [m]
_FEET_APART = 0.24
_PLATFORM, _FRONT, _LAST_GAP = (1.4, 0.8), 0.8, 0.15
# middles of stones ahead that a command aims at, its largest sideways share of the speed, and its
# largest yaw rate [rad/s]
_AHEAD, _SIDEWAYS, _TURN = 3, 0.3, 0.4
# distance from the centre of the last stone at which robots slow down [m]
_NEAR = 0.4
# load with which each foot counts without load [N]
_LEAST_LOAD = 1.0
# stones that touch may overlap by rounding errors [m]
_TOUCHING = 1e-3


@dataclass(frozen=True, eq=False)
class Course:
    """Stones in the order of a walk; arrays are read-only.

    Raises:
        ShapeError: `stones` or a polygon has another shape.
        ConfigurationError: there is no stone, a number is not finite, a polygon is not convex, two
            stones overlap, one is out of reach of all before it, or the first is not below the
            robot's feet.
    """

    stones: np.ndarray
    """(s, 6) stones, by the columns of `STONE`."""
    polygons: Mapping[int, np.ndarray] = field(default_factory=dict)
    """Corners (k, 2) of the stones that are not rectangles [m], in either direction."""

    def __post_init__(self) -> None:
        stones = np.array(self.stones, dtype=np.float64)
        if stones.ndim != 2 or stones.shape[1] != len(STONE):
            raise ShapeError(f"stones must have shape (s, {len(STONE)}), got {stones.shape}")
        check_count("the number of stones", len(stones), most=MOST_STONES)
        polygons = {i: _checked_polygon(i, corners) for i, corners in self.polygons.items()}
        for i in polygons.keys() - set(range(len(stones))):
            raise ConfigurationError(f"polygon {i!r} is of none of the {len(stones)} stones")
        for i, corners in polygons.items():
            stones[i] = *corners.mean(axis=0), stones[i, 2], *[np.nan] * 3
        for i, stone in enumerate(stones):
            good = np.isfinite(stone) & ((np.arange(len(STONE)) < 4) | (stone > 0))
            if not good[: 3 if i in polygons else None].all():
                numbers = dict(zip(STONE, stone.tolist(), strict=True))
                raise ConfigurationError(
                    f"stone {i} needs finite numbers, length and width above 0, got {numbers}"
                )
        for array in (stones, *polygons.values()):
            array.setflags(write=False)
        object.__setattr__(self, "stones", stones)
        object.__setattr__(self, "polygons", MappingProxyType(polygons))
        self._check_places()

    @cached_property
    def corners(self) -> tuple[np.ndarray, ...]:
        """Corners (k, 2) of each stone, anticlockwise [m]."""
        rectangles = stone_corners(self.stones)
        return tuple(self.polygons.get(i, rectangles[i]) for i in range(len(self.stones)))

    def _check_places(self) -> None:
        """Check where stones are; see the class for what is raised."""
        center = self.stones[:, :2]
        pairs = zip(self.corners, center, strict=True)
        radius = np.array([np.linalg.norm(c - m, axis=1).max() for c, m in pairs])
        if _gap(self.corners[0], _FEET, of_both=False) > 0 or self.stones[0, 2] != 0:
            raise ConfigurationError(
                "stone 0 must be below the robot's feet, x from -0.1 to 0.1 and y from -0.17 to"
                f" 0.17 m at height 0, got corners {self.corners[0].tolist()} at height"
                f" {self.stones[0, 2]:g}"
            )
        for i in range(1, len(center)):
            distance = np.linalg.norm(center[:i] - center[i], axis=1)
            near = np.flatnonzero(distance < radius[:i] + radius[i] + LARGEST_GAP)
            gaps = np.array([_gap(self.corners[j], self.corners[i]) for j in near])
            if (gaps < -_TOUCHING).any():
                raise ConfigurationError(f"stones {near[gaps.argmin()]} and {i} overlap")
            rises = np.abs(self.stones[near, 2] - self.stones[i, 2])
            if not ((gaps <= LARGEST_GAP) & (rises <= LARGEST_RISE)).any():
                raise ConfigurationError(
                    f"stone {i} is out of reach: no stone before it has a gap of at most"
                    f" {LARGEST_GAP} m and a difference of heights of at most {LARGEST_RISE} m"
                )

    @classmethod
    def read(cls, path: str | Path) -> Course:
        """Read a course from a JSON file, `{"stones": [stone, ...]}`.

        A stone has the numbers of `STONE`, where z and yaw are 0 by default, or `corners`, a list
        of (x, y), in place of all but z.

        Raises:
            FileDamagedError: the file is not such JSON; the message names the stone.
            ConfigurationError: no robot could walk over the course; see `Course`.
        """
        path = user_path(path)
        try:
            given = json.loads(path.read_text(encoding="utf-8"))["stones"]
            entries = [dict(stone) for stone in given]
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise FileDamagedError(
                f'{str(path)!r} must be JSON of {{"stones": [stone, ...]}}, each with the numbers'
                f" {STONE}, or corners and z ({type(error).__name__}: {error})"
            ) from error
        stones, polygons = np.full((len(entries), len(STONE)), np.nan), {}
        for i, entry in enumerate(entries):
            try:
                if "corners" in entry:
                    polygons[i] = np.array(entry.pop("corners"), dtype=np.float64)
                    stones[i, 2] = _numbers(entry, ("z",))[0]
                else:
                    stones[i] = _numbers(entry, STONE)
            except (TypeError, ValueError) as error:
                raise FileDamagedError(f"stone {i} of {str(path)!r}: {error}") from error
        return cls(stones, polygons)

    def write(self, path: str | Path) -> None:
        """Write a JSON file for `read`."""
        stones: list[dict[str, Any]] = [
            {"z": stone[2], "corners": self.polygons[i].tolist()}
            if i in self.polygons
            else dict(zip(STONE, stone.tolist(), strict=True))
            for i, stone in enumerate(self.stones)
        ]
        lines = ",\n".join(json.dumps(stone) for stone in stones)
        user_path(path).write_text(f'{{"stones": [\n{lines}\n]}}\n', encoding="utf-8")


def stone_corners(stones: Array) -> Array:
    """Corners (*b, 4, 2) of rectangular stones (*b, 6), anticlockwise [m]; arrays or tensors."""
    xp = namespace(stones)
    length, width = stones[..., 4], stones[..., 5]
    along = xp.stack([length, -length, -length, length], -1) / 2
    across = xp.stack([width, width, -width, -width], -1) / 2
    c, s = xp.cos(stones[..., 3:4]), xp.sin(stones[..., 3:4])
    turned = (c * along - s * across, s * along + c * across)
    return stones[..., None, :2] + xp.stack(turned, -1)


def stone_distances(stones: Array, points: Array) -> Array:
    """Distances (*b, k, s) along the ground from points (*b, k, 2) to stones (*b, s, 6) [m].

    Zero above a stone, infinite where is none. Of stones that are not rectangles the centre counts.
    Stones and points are arrays or tensors alike.
    """
    xp = namespace(stones)
    yaw, length, width = (xp.nan_to_num(stones[..., None, :, i]) for i in (3, 4, 5))
    x, y = (points[..., None, i] - stones[..., None, :, i] for i in (0, 1))
    c, s = xp.cos(yaw), xp.sin(yaw)
    along, across = abs(c * x + s * y) - length / 2, abs(c * y - s * x) - width / 2
    distance = xp.hypot(xp.clip(along, 0.0, None), xp.clip(across, 0.0, None))
    return xp.where(xp.isnan(distance), math.inf, distance)


def along_course(course: Array, pelvis: Array, turn: Array, speed: Array) -> Array:
    """Command (n, 3) along the middle of courses: forward, sideways [m/s], yaw rate [rad/s].

    It ends at the centre of the last stone, where it is zero.

    Args:
        course: (n, s, 6) stones, NaN where is none.
        pelvis: (n, 2) place of the pelvis [m].
        turn: (n, 1) its yaw [rad].
        speed: (n, 1) forward speed [m/s].
    """
    xp, place = namespace(course), course[..., :2]
    rows = xp.arange(len(course), device=course.device)
    last = (xp.isfinite(place[..., 0]).sum(1) - 1).clip(0)
    goals = xp.concatenate([(place[:, 1:] + place[:, :-1]) / 2, place[:, -1:]], 1)
    goals[rows, last] = place[rows, last]
    distance = xp.nan_to_num(((goals - pelvis[:, None]) ** 2).sum(-1), nan=xp.inf)
    goal = (distance.argmin(1) + _AHEAD).clip(None, last)
    ends, ahead = (goal == last)[:, None], goals[rows, goal] - pelvis
    angle = xp.arctan2(ahead[:, 1:], ahead[:, :1]) - turn
    angle = xp.arctan2(xp.sin(angle), xp.cos(angle))
    left = (ahead**2).sum(-1)[:, None] ** 0.5
    # from beyond, it steps back instead of turning round
    arrives = ends & (left < _NEAR)
    speed = xp.where(arrives, speed * xp.cos(angle) * left / _NEAR, speed)
    angle = xp.where(arrives, 0.0 * angle, angle)
    sideways = xp.sin(angle).clip(-_SIDEWAYS, _SIDEWAYS)
    command = [speed, speed * sideways, angle.clip(-_TURN, _TURN)]
    return xp.nan_to_num(xp.concatenate(command, -1))


def ground_height(stones: Array, feet: Array, load: Array) -> Array:
    """Height (*b, 1) of the stones below a robot's feet, weighted by load; zero without stones [m].

    A foot beside all stones counts as above the nearest one, so a robot that falls between them is
    low.

    Args:
        stones: (*b, s, 6) stones, NaN where is none.
        feet: (*b, 2, 2) places of the feet [m].
        load: (*b, 2) vertical forces on them [N].
    """
    if not stones.shape[-2]:
        return 0.0 * load[..., :1]
    xp, distance = namespace(stones), stone_distances(stones, feet)
    nearest = distance == xp.amin(distance, -1)[..., None]
    top = xp.nan_to_num(xp.amax(xp.where(nearest, stones[..., None, :, 2], -math.inf), -1))
    weight = xp.clip(load, 0.0, None) + _LEAST_LOAD
    return ((weight * top).sum(-1) / weight.sum(-1))[..., None]


def _numbers(entry: Mapping[str, Any], names: Sequence[str]) -> list[float]:
    """Numbers of a stone in a file, by names of `STONE`."""
    entry = {name: 0.0 for name in names if name in ("z", "yaw")} | dict(entry)
    for name in (*entry, *names):
        if name not in entry or name not in names:
            fault = "is missing" if name in names else "is unknown"
            raise ValueError(f"{name!r} {fault}; there are {tuple(names)}, or corners and z")
    return [float(entry[name]) for name in names]


def _checked_polygon(index: int, corners: Any) -> np.ndarray:
    """Corners (k, 2) of a convex polygon, anticlockwise."""
    corners = np.array(corners, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise ShapeError(f"corners of stone {index} must be (k >= 3, 2), got {corners.shape}")
    if not (np.abs(corners) < _FARTHEST).all():
        raise ConfigurationError(
            f"corners of stone {index} must be within {_FARTHEST:g} m, got {corners.tolist()}"
        )
    edge = np.roll(corners, -1, axis=0) - corners
    after = np.roll(edge, -1, axis=0)
    bend = edge[:, 0] * after[:, 1] - edge[:, 1] * after[:, 0]
    total = np.arctan2(bend, (edge * after).sum(axis=1)).sum()
    # a star turns to one side, too, but more than once
    if not (np.all(bend > 0) or np.all(bend < 0)) or abs(total) > 3 * np.pi:
        raise ConfigurationError(
            f"stone {index} must be convex, without repeated or straight corners, got"
            f" {corners.tolist()}"
        )
    return corners if bend[0] > 0 else corners[::-1].copy()


def _gap(first: np.ndarray, second: np.ndarray, *, of_both: bool = True) -> float:
    """Largest distance of two polygons along the normal of an edge; negative if they overlap.

    With `of_both` false, the farthest that `second` sticks out of `first`.
    """
    gaps = []
    for a, b in ((first, second), (second, first))[: 1 + of_both]:
        edge = np.roll(a, -1, axis=0) - a
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        beyond = ((b - a[:, None]) * normal[:, None]).sum(axis=-1)  # (edges of a, corners of b)
        gaps.append((beyond.min(axis=1) if of_both else beyond.max(axis=1)).max())
    return float(max(gaps))


def lay_stones(
    step: np.ndarray,
    *,
    apart: np.ndarray | float = _FEET_APART,
    sideways: np.ndarray | float = 0.0,
    rise: np.ndarray | float = 0.0,
    turn: np.ndarray | float = 0.0,
    size: float = STONE_SIZE,
) -> np.ndarray:
    """Square stones (*b, s + 2, 6) along a path, with both platforms.

    Args:
        step: (*b, s) distances along the path [m].
        apart: lateral distance of left and right stones [m].
        sideways: displacement to the left [m].
        rise: differences of heights [m].
        turn: changes of the path's heading before a step [rad].
        size: side of a stone [m].
    """
    heading, z = (np.cumsum(np.broadcast_to(x, step.shape), axis=-1) for x in (turn, rise))
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    left = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    path = np.cumsum(step[..., None] * ahead, axis=-2) + np.array([_FRONT - size / 2, 0.0])
    side = np.where(np.arange(step.shape[-1]) % 2, -0.5, 0.5)
    stones = np.empty((*step.shape[:-1], step.shape[-1] + 2, len(STONE)))
    stones[..., 0, :] = _FRONT - _PLATFORM[0] / 2, 0.0, 0.0, 0.0, *_PLATFORM
    inner = stones[..., 1:-1, :]
    inner[..., :2] = path + (side * apart + sideways)[..., None] * left
    inner[..., 2], inner[..., 3], inner[..., 4:] = z, heading, size
    goal = stones[..., -1, :]
    goal[..., 2:4], goal[..., 4:] = inner[..., -1, 2:4], _PLATFORM
    goal[..., :2] = path[..., -1, :] + (size / 2 + _LAST_GAP + _PLATFORM[0] / 2) * ahead[..., -1, :]
    return stones


def random_stones(
    generator: np.random.Generator,
    num: int,
    *,
    count: int = 20,
    size: float = STONE_SIZE,
    difficulty: float = 1.0,
    step: float = 0.4,
) -> np.ndarray:
    """Stones (num, count + 2, 6) of random courses, without checks, for many robots.

    Steps are 0.4 m long at difficulty 0, and 0.25 to 0.65 m at 1, where stones are displaced by up
    to 0.1 m to either side and differ by up to 0.1 m in height from the one before. Stones are at
    least 2 cm apart.

    Args:
        generator: source of the random numbers.
        num: number of courses.
        count: stones between the platforms.
        size: side of a stone [m].
        difficulty: from 0 to 1.
        step: length of steps at difficulty 0 [m].
    """
    size = check_number("size", size, 0.05, 0.6, "of stones [m]")
    difficulty = check_number("difficulty", difficulty, 0.0, 1.0)
    check_count("count", count, most=MOST_STONES - 2)
    low, high = np.array([[-0.15], [-0.1], [-0.1]]), np.array([[0.25], [0.1], [0.1]])
    draws = difficulty * generator.uniform(low, high, (num, 3, count))
    steps = np.maximum(step + draws[:, 0], size + LEAST_GAP)
    return lay_stones(steps, sideways=draws[:, 1], rise=draws[:, 2], size=size)


def random_course(
    seed: int, *, count: int = 20, size: float = STONE_SIZE, difficulty: float = 1.0
) -> Course:
    """Random course of a seed; see `random_stones`."""
    generator = np.random.default_rng(seed)
    stones = random_stones(generator, 1, count=count, size=size, difficulty=difficulty)
    return Course(stones[0])


# metres and radians, repeated along the course
_PATTERNS: Final[Mapping[str, Mapping[str, Sequence[float]]]] = MappingProxyType(
    {
        "straight": {},
        "narrow": {"apart": [0.12]},
        "wide": {"apart": [0.4]},
        "zigzag": {"turn": [0.35, 0.0, 0.0, 0.0, -0.7, 0.0, 0.0, 0.0, 0.35]},
        "alternating": {"step": [0.28, 0.58]},
        "up": {"rise": [0.08]},
        "down": {"rise": [-0.08]},
        "mixed": {
            "step": [0.4, 0.4, 0.28, 0.58, 0.28, 0.58, 0.35, 0.35],
            "apart": [0.24, 0.24, 0.12, 0.12, 0.4, 0.4, 0.24, 0.24],
            "rise": [0.08, 0.08, 0.0, 0.0, -0.08, -0.08, 0.0],
            "turn": [0.0, 0.35, 0.0, -0.35, 0.0],
        },
    }
)
PATTERNS: Final = tuple(_PATTERNS)
"""Names of the patterns: straight, feet close together, feet far apart, turns to either side,
alternating short and long steps, up, down, and all of these mixed."""


def pattern(name: str, *, count: int = 20, size: float = STONE_SIZE) -> Course:
    """Course of one of the eight `PATTERNS`, the kinds of Duan et al. 2022, with numbers of ours.

    Raises:
        UnknownNameError: there is no such pattern.
    """
    if name not in _PATTERNS:
        raise UnknownNameError.among("pattern", name, PATTERNS)
    check_count("count", count)
    rows = {"step": [0.4]} | dict(_PATTERNS[name])
    return Course(lay_stones(**{k: np.resize(v, count) for k, v in rows.items()}, size=size))


def find_course(name: str) -> Course:
    """Course by the name of one of the `PATTERNS`, the seed of a random one, or a file.

    Raises:
        FileDamagedError, ConfigurationError: see `Course.read`.
        OSError: there is no such file.
    """
    if name in PATTERNS:
        return pattern(name)
    return random_course(int(name)) if name.isdecimal() else Course.read(name)


def stairs(rise: float, *, steps: int = 6, run: float = 0.3, width: float = 1.2) -> Course:
    """Stairs between two platforms; a negative rise leads down.

    Args:
        rise: height of a step [m].
        steps: number of steps, the last one onto the goal's platform.
        run: length of a tread [m].
        width: width of the treads and platforms [m].
    """
    stones = np.zeros((check_count("steps", steps) + 1, len(STONE)))
    stones[:, 0] = _FRONT + run * (np.arange(len(stones)) - 0.5)
    stones[:, 2] = rise * np.arange(len(stones))
    stones[:, 4:] = run, width
    stones[[0, -1], 4] = _PLATFORM[0]
    stones[[0, -1], 0] += np.array([-1, 1]) * (_PLATFORM[0] - run) / 2
    return Course(stones)
