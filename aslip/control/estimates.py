"""Arrays of the estimates of robots that estimate their own state; needs no PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import CASSIE, Robot
from aslip.robot.robot import LARGEST, is_possible
from aslip.robot.rotation import yaw

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


def is_estimate(packets: object) -> bool:
    """Check whether a mapping has the entries of an estimate, not those of packets."""
    return isinstance(packets, Mapping) and "height" in packets


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


def check_rows(rows: np.ndarray, robot: Robot, num: int | None = None) -> np.ndarray:
    """Check the shape of packets (n, w, p) or joined estimates (n, e), and return them.

    Args:
        rows: the array.
        robot: robot that gives the sizes p and e.
        num: number n of robots that are controlled already.

    Raises:
        ShapeError: the shape is neither, or of another number of robots.
    """
    packet, own = robot.packet_size, sum(robot.estimate_sizes.values())
    # the estimator checks the width of packets
    if rows.ndim != 3 and not (rows.ndim == 2 and rows.shape[1] in (own, own + 3)):
        raise ShapeError(
            f"packets must have shape (n, w, {packet}), or ({packet},) of one robot, and joined"
            f" estimates (n, {own}), or (n, {own + 3}) with a position, got {rows.shape}"
        )
    if num is not None and len(rows) != num:
        raise ShapeError(f"packets or estimates must come from {num} robots, got {len(rows)}")
    return rows


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


def start_heading(rows: np.ndarray, heading: ArrayLike | None, robot: Robot) -> np.ndarray:
    """Headings (n, 1) of robots that start with estimates (n, e) [rad].

    Args:
        rows: joined estimates.
        heading: yaw that counts as straight ahead, in the frame of the estimates [rad], one or
            (n, 1); by default that of the estimates.
        robot: robot that gives the sizes of the entries.

    Raises:
        ConfigurationError: an estimate or a heading is not finite, or a robot cannot have it.
        ShapeError: `heading` has neither one number nor one per robot.
    """
    parts = split_estimate(rows, robot)
    for i in range(len(rows)):
        first = {name: part[i] for name, part in parts.items()}
        if lost := lost_entries(first):
            raise ConfigurationError(
                f"the first estimate of a robot must be finite and possible: {lost[0]} is"
                f" {first[lost[0]].tolist()}; wait until the robot's estimator is ready"
            )
    orientation = parts["orientation"]
    ahead = yaw(orientation) if heading is None else np.asarray(heading, np.float64)
    if not np.isfinite(ahead).all():
        raise ConfigurationError(f"heading must be finite, got {ahead.tolist()}")
    if ahead.size not in (1, len(rows)):
        raise ShapeError(f"heading must be one number or ({len(rows)}, 1), got {ahead.shape}")
    return np.broadcast_to(ahead.reshape(-1, 1), (len(rows), 1)).copy()
