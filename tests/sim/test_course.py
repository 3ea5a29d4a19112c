"""Courses as data: patterns, random ones, and files of one's own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aslip.errors import AslipError, ConfigurationError, FileDamagedError, ShapeError
from aslip.sim.course import (
    PATTERNS,
    Course,
    along_course,
    ground_height,
    pattern,
    random_course,
    random_stones,
    stairs,
)

START = [-0.1, 0.0, 0.0, 0.0, 1.0, 0.8]
SQUARE = np.array([[0.5, -0.1], [0.7, -0.1], [0.7, 0.1], [0.5, 0.1]])


@pytest.mark.parametrize("name", PATTERNS)
def test_patterns_are_what_their_names_say(name: str) -> None:
    """Feet alternate, the left one first; all patterns pass the checks of courses."""
    x, y, z, yaw = pattern(name).stones[1:-1, :4].T
    assert len(x) == 20
    apart, step, rise = np.abs(np.diff(y)), np.diff(x), np.diff(z)
    turns = name in ("zigzag", "mixed")
    assert (np.ptp(yaw) > 0.3) == turns
    if not turns:
        assert (np.sign(y) == np.resize([1, -1], 20)).all()
        np.testing.assert_allclose(apart, {"narrow": 0.12, "wide": 0.4}.get(name, 0.24))
        expected = [0.58, 0.28] if name == "alternating" else [0.4]
        np.testing.assert_allclose(step, np.resize(expected[::-1], 20)[1:])
        np.testing.assert_allclose(rise, {"up": 0.08, "down": -0.08}.get(name, 0.0), atol=1e-12)


def test_random_courses_are_as_hard_as_they_say() -> None:
    stones = random_stones(np.random.default_rng(0), 500)[:, 1:-1]
    step, rise = np.diff(stones[..., 0]), np.diff(stones[..., 2])
    side = stones[..., 1] - 0.12 * np.resize([1, -1], 20)
    for value, low, high in ((step, 0.25, 0.65), (side, -0.1, 0.1), (rise, -0.1, 0.1)):
        assert low <= value.min() < low + 0.01 and high - 0.01 < value.max() <= high
    np.testing.assert_array_equal(random_course(3).stones, random_course(3).stones)
    assert (random_course(3).stones != random_course(4).stones).any()
    easy = random_course(5, difficulty=0.0)
    np.testing.assert_allclose(easy.stones, pattern("straight").stones, atol=1e-12)
    for size in (0.15, 0.3):
        assert random_course(0, size=size, count=5).stones[3, 4] == size


def test_stairs_touch_and_rise() -> None:
    stones = stairs(-0.15, steps=4).stones
    np.testing.assert_allclose(np.diff(stones[:, 2]), -0.15)
    ends = stones[:, 0] + 0.5 * stones[:, 4] * np.array([[-1], [1]])
    np.testing.assert_allclose(ends[0, 1:], ends[1, :-1])


def test_commands_end_at_the_centre_of_the_last_stone() -> None:
    """Robots slow down there, and step back from beyond instead of turning round."""
    stones = pattern("straight").stones
    end = stones[-1, 0]
    courses = np.repeat(stones[None], 4, 0)
    courses[3] = np.nan
    pelvis = np.array([[0.0, 0.0], [end, 0.0], [end + 0.1, 0.0], [end, 0.0]])
    still, speed = np.zeros((4, 1)), np.full((4, 1), 0.5)
    for as_own in (np.asarray, torch.as_tensor):
        command = along_course(*map(as_own, (courses, pelvis, still, speed)))
        np.testing.assert_allclose(command[:, 0], [0.5, 0.0, -0.125, 0.5], atol=1e-12)
        np.testing.assert_allclose(command[1:, 1:], 0.0, atol=1e-12)
        # one stone alone is a course, too
        alone = along_course(*map(as_own, (courses[:1, -1:], pelvis[1:2], still[:1], speed[:1])))
        np.testing.assert_allclose(alone, 0.0, atol=1e-12)


def _course(*stones: Any, polygons: dict[int, Any] | None = None) -> Course:
    return Course(np.array([START, *stones], dtype=float), polygons or {})


def test_ground_is_that_of_the_nearest_stones_weighted_by_load() -> None:
    """Distances count to the edge of a rectangle and to the centre of a polygon."""
    nan = [np.nan] * 3
    course = [START, [0.7, 0.0, 0.2, np.pi / 2, 0.1, 0.4], [2.0, 0.0, -0.3, *nan], 2 * nan]
    stones = np.array([course, course, course, 4 * [2 * nan]])
    # on both stones, beside the second one and above the polygon, without load, without stones
    feet = np.array([[[0.0, 0.1], [0.8, 0.04]], [[0.95, 0.0], [2.1, 0.0]], *2 * [np.eye(2)]])
    feet[2] = [[0.3, 0.0], [0.7, 0.0]]
    load = np.array([[100.0, 299.0], [0.0, 400.0], [0.0, 0.0], [100.0, 100.0]])
    expected = np.array([[0.2 * 300 / 401], [(0.2 - 0.3 * 401) / 402], [0.1], [0.0]])
    for as_own in (np.asarray, torch.as_tensor):
        found = ground_height(as_own(stones), as_own(feet), as_own(load))
        np.testing.assert_allclose(found, expected, atol=1e-12)


ROW = [0.0] * 6
FAULTS: dict[str, tuple[Any, str]] = {
    "empty": (lambda: Course(np.empty((0, 6))), "number of stones must be a whole number of 1"),
    "shape": (lambda: Course(np.zeros(6)), r"must have shape \(s, 6\), got \(6,\)"),
    "nan": (lambda: _course([0.7, 0, np.nan, 0, 0.2, 0.2]), "stone 1 needs finite .*'z': nan"),
    "no size": (lambda: _course([0.7, 0, 0, 0, 0.2, 0.0]), "stone 1 needs finite .*'width': 0.0"),
    "far": (lambda: _course([1.5, 0, 0, 0, 0.2, 0.2]), "stone 1 is out of reach.* 0.6 m"),
    "high": (lambda: _course([0.7, 0, 0.4, 0, 0.2, 0.2]), "stone 1 is out of reach.* 0.3 m"),
    "overlap": (lambda: _course([0.45, 0, 0.1, 0.5, 0.2, 0.2]), "stones 0 and 1 overlap"),
    "start": (lambda: Course(np.array([[1.0, *START[1:]]])), "stone 0 must be below the robot's"),
    "start height": (lambda: Course(np.array([[0, 0, 0.1, 0, 1, 1]])), "at height 0.1"),
    "not convex": (
        lambda: _course(ROW, polygons={1: [*SQUARE, [0.6, 0.0]]}), "stone 1 must be convex"
    ),
    "star": (
        lambda: _course(ROW, polygons={1: [
            [0.7 + 0.1 * np.cos(a), 0.1 * np.sin(a)] for a in 0.8 * np.pi * np.arange(5)
        ]}), "stone 1 must be convex",
    ),
    "line": (lambda: _course(ROW, polygons={1: SQUARE[:2]}), r"be \(k >= 3, 2\), got \(2, 2\)"),
    "stray": (lambda: _course(polygons={1: SQUARE}), "polygon 1 is of none of the 1 stones"),
    "infinite": (
        lambda: _course(ROW, polygons={1: SQUARE * np.inf}), "stone 1 must be within 1000 m"
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_course_that_no_robot_can_walk_is_refused(fault: str) -> None:
    make, message = FAULTS[fault]
    with pytest.raises((ConfigurationError, ShapeError), match=message):
        make()


def test_a_course_of_ones_own_is_a_file(tmp_path: Path) -> None:
    """Corners may go either way round; polygons and rectangles mix."""
    path = tmp_path / "own.json"
    rectangle = {"x": 0.0, "y": 0.0, "length": 0.8, "width": 0.8}
    polygon = {"corners": SQUARE[::-1].tolist(), "z": 0.05}
    path.write_text(json.dumps({"stones": [rectangle, polygon]}))
    course = Course.read(path)
    np.testing.assert_array_equal(course.stones[0], [0, 0, 0, 0, 0.8, 0.8])
    assert course.stones[1, 2] == 0.05 and np.isnan(course.stones[1, 3:]).all()
    np.testing.assert_allclose(sorted(course.corners[1].tolist()), sorted(SQUARE.tolist()))
    course.write(path)
    again = Course.read(path)
    np.testing.assert_array_equal(again.stones, course.stones)
    np.testing.assert_array_equal(again.corners[1], course.corners[1])
    with pytest.raises(ValueError, match="read-only"):
        course.stones[0, 0] = 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stones: 3", "must be JSON of"),
        ('{"stones": 3}', "must be JSON of"),
        ('{"stones": [{"x": 0}]}', "'y' is missing"),
        ('{"stones": [{"z": 0, "corners": [], "yaw": 1}]}', "'yaw' is unknown"),
        ('{"stones": [{"x": 0, "y": "a", "length": 1, "width": 1}]}', "stone 0 of .*'a'"),
        ('{"stones": [{"x": null, "y": 0, "length": 1, "width": 1}]}', "stone 0 of .*None"),
        ('{"stones": [{"corners": [[0, 0], [1]]}]}', "stone 0 of .*inhomogeneous"),
        ('{"stones": [{"x": NaN, "y": 0, "length": 1, "width": 1}]}', "needs finite"),
        ('{"stones": []}', "number of stones"),
    ],
)
def test_files_of_another_kind_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "course.json"
    path.write_text(text)
    with pytest.raises(AslipError, match=message) as error:
        Course.read(path)
    assert isinstance(error.value, FileDamagedError | ConfigurationError)
