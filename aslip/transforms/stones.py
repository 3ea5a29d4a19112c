"""Stones of simulated robots: courses drawn at resets, and what robots see of them.

In a stack, `RandomCourse` comes first, and `SeenStones` after the estimator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, Unbounded

from aslip.base.checks import check_count, check_number
from aslip.errors import ConfigurationError, ShapeError
from aslip.library import GaitLibrary
from aslip.robot import NoiseLevel
from aslip.sim.course import STONE, Course, along_course, stone_corners, stone_distances
from aslip.transforms.base import ChosenAtReset, SeededTransform, require_keys
from aslip.transforms.command import VelocityCommand
from aslip.transforms.rotation import heading_to_world, rotate_about_vertical, rotate_inverse, yaw

# names of leaves differ from those of groups: `ParallelEnv` confuses them
COURSE_KEY: Final = ("stones", "course")
"""Key of the stones (n, s, 6) of simulated robots, by the columns of `aslip.sim.course.STONE`."""
SHOWN_KEY: Final = ("stones", "shown")
"""Key of the stones (n, s, 6) that robots see, where these differ from those of the course."""
OUTLINE_KEY: Final = ("stones", "outline")
"""Key of the corners (n, s, e, 2) of a course with stones that are not rectangles [m]."""
_REQUEST_KEY = ("course", "stones")
SIGHT_NOISE: Final = NoiseLevel(white=0.005, bias=0.01)
"""Standard deviations of a stone's place on each axis [m], ours."""


class RandomCourse(ChosenAtReset):
    """Draw a course for each robot at each of its resets, all with equal chance.

    Writes its stones as `("stones", "course")` (n, s, 6) at resets and steps, in single precision
    and NaN where is none; s is the length of the longest course. To choose, pass this entry, or
    `("course", "stones")`, to `env.reset`. A partial reset (with a `_reset` mask) draws for the
    reset robots only.

    Courses start below the world's origin, where `ReferenceStart` puts robots. Feet of a start at
    up to 1 m/s are within 0.36 m ahead and back, on the first stone of patterns and random courses.

    For many random courses: `RandomCourse(random_stones(np.random.default_rng(0), 10_000))`.

    Stones that are not rectangles are possible in a single course, for all robots. Robots see them,
    and `SimulatedEnv.set_course` makes them physical.

    Args:
        courses: courses, or the stones (p, s, 6) of courses of rectangular ones.
        shown: stones (p, s, 6) that robots see of each course instead of all there are, written as
            `("stones", "shown")`: where the ground is larger than shown, robots learn where to step
            before they can fall.

    Raises:
        ConfigurationError: there is no course, or a stone of several is not a rectangle.
        ShapeError: the stones have another shape.
    """

    needs_env = "it places stones at resets"

    def __init__(
        self, courses: Sequence[Course] | np.ndarray, shown: np.ndarray | None = None
    ) -> None:
        outline = None
        if not isinstance(courses, np.ndarray):
            if any(course.polygons for course in courses):
                outline = _outline(courses)
            longest = max((len(course.stones) for course in courses), default=0)
            rows = np.full((len(courses), longest, len(STONE)), np.nan)
            for row, course in zip(rows, courses, strict=True):
                row[: len(course.stones)] = course.stones
            courses = rows
        if courses.ndim != 3 or courses.shape[2] != len(STONE):
            raise ShapeError(f"stones must be (p, s, {len(STONE)}), got {courses.shape}")
        if not courses.size:
            raise ConfigurationError(f"courses must be one or more, got {courses.shape}")
        if shown is not None and shown.shape != courses.shape:
            raise ShapeError(f"shown stones must be {courses.shape}, got {shown.shape}")
        given = {COURSE_KEY: courses, SHOWN_KEY: shown, OUTLINE_KEY: outline}
        rows = {k: torch.tensor(v, dtype=torch.float32) for k, v in given.items() if v is not None}
        super().__init__([], dict.fromkeys(rows, len(STONE)))
        self._rows = rows

    def _drawn(self, request: TensorDictBase) -> dict[NestedKey, Tensor]:
        given = None if "_reset" in request else request.get(_REQUEST_KEY, None)
        if OUTLINE_KEY in self._rows:
            if given is not None:
                raise ConfigurationError(
                    f"{_REQUEST_KEY} places rectangular stones, but this course has others"
                )
        elif "_reset" not in request:
            given = request.get(COURSE_KEY, given)
        if given is not None:
            return dict.fromkeys(self._rows, cast("Tensor", given))
        count = len(self._rows[COURSE_KEY])
        chosen = torch.randint(count, request.batch_size, generator=self.generator)
        return {key: rows[chosen] for key, rows in self._rows.items()}

    def _accept(self, request: TensorDictBase) -> TensorDictBase:
        given = request[COURSE_KEY]
        shape = (*request.batch_size, *self._rows[COURSE_KEY].shape[1:])
        if tuple(given.shape) != shape:
            raise ShapeError(f"{COURSE_KEY} must have shape {shape}, got {tuple(given.shape)}")
        request.set(COURSE_KEY, given.float())
        return request if OUTLINE_KEY in self._rows else request.set(_REQUEST_KEY, given.float())

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.update(tensordict.select(*self.out_keys))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the stones."""
        for key, rows in self._rows.items():
            shape = torch.Size((*observation_spec.shape, *rows.shape[1:]))
            observation_spec[key] = Unbounded(shape, dtype=torch.float32)
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the stones as an entry that a caller may set."""
        return self.transform_observation_spec(state_spec)


class CourseCommand(VelocityCommand):
    """Draw commands, and lead robots with stones along the middle of their course to its end.

    The forward speed of these is that of the draw, moved to a range; sideways speed and yaw rate
    aim at the stones ahead. Zero commands stay, and the robot steps in place. The other robots have
    the commands of `VelocityCommand`.

    Must come before `RandomCourse`: TorchRL prepares resets from the last transform to the first.

    Args:
        library: gaits over forward speed, sideways speed and yaw rate.
        interval: mean time between draws within an episode [s].
        speeds: least and greatest speed on courses [m/s].
    """

    def __init__(
        self,
        library: GaitLibrary,
        interval: float = math.inf,
        *,
        speeds: tuple[float, float] = (0.3, 1.1),
    ) -> None:
        super().__init__(library, interval)
        self.speeds = speeds

    def _drawn(self, request: TensorDictBase) -> dict[NestedKey, Tensor]:
        command = self.draw(self._shape(request))
        course = cast("Tensor", request[COURSE_KEY])
        start = torch.zeros(len(command), 2)
        return {"command": self._led(command, course, start, torch.zeros(len(command), 1))}

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        command = cast("Tensor", super()._step(tensordict, next_tensordict)["command"])
        truth = cast("TensorDictBase", next_tensordict["truth"])
        course, turn = tensordict[COURSE_KEY], yaw(truth["pelvis_orientation"])
        led = self._led(command, course, truth["pelvis_position"][:, :2], turn)
        return next_tensordict.set("command", led)

    def _led(self, command: Tensor, course: Tensor, pelvis: Tensor, turn: Tensor) -> Tensor:
        speed = command[:, :1].clamp(*self.speeds)
        led = self.library.nearest(along_course(course, pelvis, turn, speed))
        moves = (command != 0).any(1, keepdim=True)
        return torch.where(has_stones(course) & moves, led, command)


class SeenStones(SeededTransform):
    """Write the stones that a robot sees, in the frame of its estimated odometry.

    They are `("stones", "corners")` (n, m, e, 2), anticlockwise, e = 4 for rectangles, and
    `("stones", "height")` (n, m) [m], in the order of the course and NaN where is none: the m
    stones nearest to a point ahead of the pelvis. A camera on the pelvis would see them like that:
    in their true places relative to the pelvis and its yaw, with noise, and so in the odometry with
    its errors. Heights count as those of `("odometry", "left_foot_position")` do.

    `("stones", "error")` (n, s, 3) is the part of the noise that lasts for an episode.

    Must come after `RandomCourse`, `HeadingFrame` and the estimator.

    Args:
        count: number m of stones.
        ahead: distance of the point from the pelvis [m].
        noise: standard deviations of a stone's place on each axis [m], `white` for each step and
            `bias` for an episode.

    Raises:
        ConfigurationError: a setting is out of range.
    """

    needs_env = "errors of sight last for an episode"

    def __init__(
        self, count: int = 16, *, ahead: float = 0.6, noise: NoiseLevel = SIGHT_NOISE
    ) -> None:
        pose = ("pelvis_position", "pelvis_orientation")
        keys = [COURSE_KEY, "heading", ("truth", "slope"), ("true_odometry", pose[1])]
        keys += [(group, name) for group in ("truth", "odometry") for name in pose]
        names = ("corners", "height", "error")
        super().__init__(keys, [("stones", name) for name in names])
        self.count, self.ahead = check_count("count", count), check_number("ahead", ahead)
        self.noise = noise
        levels = (np.asarray(level, np.float32) for level in (noise.white, noise.bias))
        self._white, self._bias = map(torch.as_tensor, levels)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        stones = _shown(tensordict_reset)
        return self._see(tensordict_reset, self._normal(stones[..., :3], self._bias))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._see(next_tensordict, cast("Tensor", tensordict[self.out_keys[2]]))

    def _see(self, td: TensorDictBase, error: Tensor) -> TensorDictBase:
        """Write stones with an error (n, s, 3) for the episode."""
        truth, seen = (cast("TensorDictBase", td[group]) for group in ("truth", "odometry"))
        stones = _shown(td)
        chosen = self._nearest(stones, truth["pelvis_position"], yaw(truth["pelvis_orientation"]))
        outline = td.get(OUTLINE_KEY, None)
        shift, stones = (x.take_along_dim(chosen, 1) for x in (error, stones))
        shift = shift + self._normal(shift, self._white)
        if outline is None:
            corners = stone_corners(stones)
        else:
            corners = outline.take_along_dim(chosen[..., None], 1)
        top = stones[..., None, 2:3].expand_as(corners[..., :1])
        points = torch.cat([corners, top], dim=-1) + shift.unsqueeze(-2)
        frame = heading_to_world(truth["slope"], td["heading"])[:, None, None]
        placed = rotate_inverse(frame, points - truth["pelvis_position"][:, None, None])
        turn = yaw(seen["pelvis_orientation"]) - yaw(td["true_odometry", "pelvis_orientation"])
        placed = rotate_about_vertical(placed, turn[:, None, None])
        placed = placed + seen["pelvis_position"][:, None, None]
        values = (placed[..., :2], placed[..., 2].mean(-1), error)
        for key, value, count in zip(
            self.out_keys, values, (self.count, self.count, 0), strict=True
        ):
            td.set(key, _padded(value, count))
        return td

    def _nearest(self, stones: Tensor, pelvis: Tensor, turn: Tensor) -> Tensor:
        """(n, m or less, 1) places of the nearest stones, in the order of the course."""
        point = pelvis[:, :2] + self.ahead * torch.cat([turn.cos(), turn.sin()], dim=-1)
        distance = stone_distances(stones, point[:, None])[:, 0]
        count = min(self.count, stones.shape[1])
        nearest = distance.topk(count, dim=-1, largest=False).indices
        return nearest.sort(dim=-1).values.unsqueeze(-1)

    def _normal(self, like: Tensor, deviation: Tensor) -> Tensor:
        """Normal numbers of the shape of a tensor (n, k, 3)."""
        return deviation * torch.randn(like.shape, generator=self.generator, dtype=torch.float32)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the seen stones and their errors."""
        require_keys(self, observation_spec, self.in_keys)
        total, edges = observation_spec[COURSE_KEY].shape[1], 4
        if OUTLINE_KEY in observation_spec.keys(True):
            edges = observation_spec[OUTLINE_KEY].shape[2]
        shapes = ((self.count, edges, 2), (self.count,), (total, 3))
        for key, shape in zip(self.out_keys, shapes, strict=True):
            whole = torch.Size((*observation_spec.shape, *shape))
            observation_spec[key] = Unbounded(whole, dtype=torch.float32)
        return observation_spec


def _outline(courses: Sequence[Course]) -> np.ndarray:
    """Corners (1, s, e, 2) of a course; the last one of stones with fewer is repeated.

    Raises:
        ConfigurationError: there are several courses.
    """
    if len(courses) > 1:
        raise ConfigurationError(
            f"stones that are not rectangles are for a single course, got {len(courses)} courses"
        )
    most = max(map(len, courses[0].corners))
    padded = [np.pad(c, ((0, most - len(c)), (0, 0)), mode="edge") for c in courses[0].corners]
    return np.array(padded)[None]


def has_stones(stones: Tensor) -> Tensor:
    """Mask (n, 1) of the robots with stones (n, s, 6)."""
    return torch.isfinite(stones[..., 0]).any(1, keepdim=True)


def _shown(td: TensorDictBase) -> Tensor:
    """Stones (n, s, 6) that robots see."""
    return cast("Tensor", td.get(SHOWN_KEY, td[COURSE_KEY]))


def _padded(value: Tensor, count: int) -> Tensor:
    """Values (n, k, ...) with rows of NaN up to a count."""
    missing = max(count - value.shape[1], 0)
    return torch.cat([value, value.new_full((len(value), missing, *value.shape[2:]), torch.nan)], 1)
