"""Estimates that robots make themselves, in place of packets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch import Tensor

from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import Robot
from aslip.robot.rotation import normalize, orientation_to_heading, vector_to_heading
from aslip.robot.rotation import yaw as yaw_of
from aslip.transforms.estimate import estimate_sizes


def is_estimate(packets: object) -> bool:
    """Whether a mapping has the entries of an estimate rather than those of packets."""
    return isinstance(packets, Mapping | TensorDictBase) and "height" in packets


def join_estimate(entries: Mapping[str, ArrayLike], robot: Robot) -> np.ndarray:
    """Join the entries of estimates, (n, k) each or (k,) of one robot, to an array (n, e).

    Raises:
        UnknownNameError: an entry is missing.
        ShapeError: an entry has the wrong shape.
    """
    sizes, columns = estimate_sizes(robot), []
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


def start_entries(rows: np.ndarray, heading: ArrayLike | None, robot: Robot) -> dict[str, object]:
    """Entries of robots with estimates (n, e) that start.

    Args:
        rows: joined estimates.
        heading: yaw that counts as straight ahead, in the frame of the estimates [rad], one or
            (n, 1); by default that of the estimates.
        robot: robot that gives the sizes of the entries.

    Raises:
        ConfigurationError: an estimate or a heading is not finite.
    """
    if not np.isfinite(rows).all():
        raise ConfigurationError("estimates of robots that start must be finite")
    part = _parts(rows, robot)
    ahead = yaw_of(part["orientation"]) if heading is None else np.asarray(heading, np.float64)
    if not np.isfinite(ahead).all():
        raise ConfigurationError(f"heading must be finite, got {ahead.tolist()}")
    if ahead.size not in (1, len(rows)):
        raise ShapeError(f"heading must be one number or ({len(rows)}, 1), got {ahead.shape}")
    return _entries(part, np.broadcast_to(ahead.reshape(-1), (len(rows),)))


def next_entries(
    past: TensorDictBase, rows: np.ndarray, heading: Tensor | None, robot: Robot
) -> dict[str, object]:
    """Entries of robots with new estimates (n, e); for those that are not finite the last hold.

    Args:
        past: entries of the last policy step.
        rows: joined estimates.
        heading: new yaw (n, 1) that counts as straight ahead [rad], or None.
        robot: robot that gives the sizes of the entries.
    """
    ahead = cast("Tensor", past["heading"] if heading is None else heading.double())
    entries = _entries(_parts(rows, robot), ahead[:, 0].numpy())
    lost = torch.from_numpy(~np.isfinite(rows).all(axis=1, keepdims=True))
    if lost.any():
        estimate = cast("dict[str, Tensor]", entries["estimate"])
        entries["estimate"] = {
            name: torch.where(lost, cast("Tensor", past["estimate", name]), value)
            for name, value in estimate.items()
        }
    return entries


def _parts(rows: np.ndarray, robot: Robot) -> dict[str, np.ndarray]:
    """Entries of joined estimates."""
    sizes = estimate_sizes(robot)
    parts = np.split(rows, np.cumsum(list(sizes.values()))[:-1], axis=1)
    return dict(zip(sizes, parts, strict=True))


def _entries(part: dict[str, np.ndarray], heading: np.ndarray) -> dict[str, object]:
    """Entries in a tensordict: estimates in frames with x along headings (n,), and headings."""
    turned = {
        **part,
        "orientation": normalize(orientation_to_heading(heading, part["orientation"])),
        "velocity": vector_to_heading(heading, part["velocity"]),
    }
    single = {name: torch.tensor(value, dtype=torch.float32) for name, value in turned.items()}
    return {"estimate": single, "heading": torch.tensor(heading[:, None].copy())}
