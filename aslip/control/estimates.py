"""Arrays of the estimates of robots that estimate their own state; needs no PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import CASSIE, Robot
from aslip.robot.robot import LARGEST, is_possible

POSITION = "position"
"""Optional entry of an estimate: position of the pelvis (3,) [m], level in the frame of the
estimates; policies that observe their distance from the commanded path need it."""


def standing_estimate(robot: Robot = CASSIE) -> dict[str, np.ndarray]:
    """Estimate (k,) of a robot that stands upright at rest, with its position."""
    at, qpos = robot.indices, robot.standing.copy()
    return {
        **{name: np.zeros(size) for name, size in robot.estimate_sizes.items()},
        "height": qpos[at.pelvis_position][2:],
        "orientation": np.array([1.0, 0.0, 0.0, 0.0]),
        "motor_position": qpos[at.motor_qpos],
        "joint_position": qpos[at.joint_qpos],
        POSITION: qpos[at.pelvis_position],
    }


def join_estimate(entries: Mapping[str, ArrayLike], robot: Robot) -> np.ndarray:
    """Join the entries of estimates, (n, k) each or (k,) of one robot, to an array (n, e).

    The last columns are those of `POSITION`, if the estimates have it.

    Raises:
        UnknownNameError: an entry is missing.
        ShapeError: an entry has the wrong shape.
    """
    sizes, columns = _sizes(robot, POSITION in entries), []
    for name, size in sizes.items():
        if name not in entries:
            raise UnknownNameError(f"an estimate needs {list(sizes)}; {name!r} is missing")
        column = np.atleast_2d(np.asarray(entries[name], dtype=np.float64))
        if column.ndim != 2 or column.shape[1] != size:
            raise ShapeError(
                f"{name} of an estimate must have shape (n, {size}), got {column.shape}"
            )
        columns.append(column)
    if len({len(column) for column in columns}) > 1:
        raise ShapeError(f"entries of an estimate differ in length: {[len(c) for c in columns]}")
    return np.concatenate(columns, axis=1)


def split_estimate(rows: np.ndarray, robot: Robot) -> dict[str, np.ndarray]:
    """Split joined estimates (n, e) into entries (n, k)."""
    sizes = _sizes(robot, rows.shape[1] > sum(robot.estimate_sizes.values()))
    parts = np.split(rows, np.cumsum(list(sizes.values()))[:-1], axis=1)
    return dict(zip(sizes, parts, strict=True))


def _sizes(robot: Robot, placed: bool) -> dict[str, int]:
    """Sizes of the entries of an estimate, with or without a position."""
    return {**robot.estimate_sizes, **({POSITION: 3} if placed else {})}


def lost_entries(estimate: Mapping[str, np.ndarray]) -> list[str]:
    """Entries (k,) of a robot's estimate that are not finite, or that no robot can have."""
    return [name for name, value in estimate.items() if not is_possible(name, value)]


def mark_lost(rows: np.ndarray, robot: Robot) -> np.ndarray:
    """Joined estimates (n, e) with NaN in place of entries that no robot can have."""
    largest, at = _limits(robot, rows.shape[1])
    good = np.abs(rows) <= largest
    for name, part in at.items():
        good[:, part] &= is_possible(name, rows[:, part])[:, None]
    return rows if good.all() else np.where(good, rows, np.nan)


@cache
def _limits(robot: Robot, width: int) -> tuple[np.ndarray, dict[str, slice]]:
    """Largest values (e,) of joined estimates, and places of entries with more conditions."""
    sizes = _sizes(robot, width > sum(robot.estimate_sizes.values()))
    ends = np.cumsum(list(sizes.values()))
    places = {name: slice(end - sizes[name], end) for name, end in zip(sizes, ends, strict=True)}
    largest = np.concatenate([np.full(size, LARGEST[name]) for name, size in sizes.items()])
    return largest, {name: places[name] for name in ("height", "orientation")}


def check_first(rows: np.ndarray, robot: Robot) -> None:
    """Check the joined estimates (n, e) of robots that start.

    Raises:
        ConfigurationError: an estimate is not finite, or a robot cannot have it.
    """
    parts = split_estimate(rows, robot)
    for i in range(len(rows)):
        first = {name: part[i] for name, part in parts.items()}
        if lost := lost_entries(first):
            raise ConfigurationError(
                f"the first estimate of a robot must be finite and possible: {lost[0]} is"
                f" {first[lost[0]].tolist()}; wait until the robot's estimator is ready"
            )
