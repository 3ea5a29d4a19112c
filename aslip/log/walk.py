"""Read a walk from a log, in the form that metrics take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from aslip.log.reader import Recording, Series
from aslip.robot import CASSIE, SIDES
from aslip.transforms import ODOMETRY_SIZES
from aslip.transforms.heading import in_heading_frame, start_of, true_heading
from aslip.walking import Walks
from aslip.walking.record import frame_poses

_COMMAND = ("forward", "sideways", "yaw_rate")
_FEET = tuple(f"{side}_foot_position" for side in SIDES)


def read_walk(recording: Recording) -> Walks:
    """First episode of a log, n = 1; x is the heading of the pelvis at its start.

    In stacks for all directions, x is the heading of the frame along the path, as in
    `record_walks`.

    Raises:
        UnknownNameError: the log has no reference or no truth.
    """
    step, truth, reference = (recording[t] for t in ("/step", "/truth", "/reference"))
    ticks = step.ticks
    # a reset takes the time of a policy step, so the first gap ends the episode
    gaps = np.flatnonzero(np.diff(ticks) > 1)
    count = int(gaps[0]) + 1 if len(gaps) else len(ticks)
    rows = np.searchsorted(truth.ticks, ticks[:count])

    def columns(series: Any, names: Sequence[str], at: Any) -> np.ndarray:
        return np.stack([series[name][at] for name in names], axis=1)

    def vectors(series: Any, names: Sequence[str], axes: str = "xyz") -> np.ndarray:
        return np.stack([series.vector(name, axes)[rows] for name in names], axis=1)

    turning = f"command_{_COMMAND[0]}" in step.columns
    body = _odometry(recording["/true_odometry"]) if turning else _from_start(truth)
    alive = ~np.logical_or.accumulate(step["terminated"][:count] > 0)
    forces = [[f"ground_force_{side}_{axis}" for axis in "xyz"] for side in SIDES]
    arrays = {
        "phase": reference["phase"][rows],
        "reward": step["reward"][:count],
        "action": columns(step, [f"action_{name}" for name in CASSIE.motor_names], slice(count)),
        "pelvis_position": body["pelvis_position"][rows],
        "pelvis_orientation": body["pelvis_orientation"][rows],
        "pelvis_velocity": body["pelvis_velocity"][rows],
        "foot_position": np.stack([body[name][rows] for name in _FEET], axis=1),
        "ground_force": np.stack([columns(step, names, slice(count)) for names in forces], axis=1),
        "body_position": reference.vector("body_position")[rows],
        "body_velocity": reference.vector("body_velocity")[rows],
        "body_to_foot": vectors(reference, _FEET),
    }
    arrays["frame"] = np.zeros((count, 3))
    if turning:
        odometry = recording["/true_odometry"]
        origin, heading = odometry.vector("origin"), odometry["heading"][:, None]
        arrays["frame"] = frame_poses(origin[rows, None], heading[rows, None])[:, 0]
    # undefined after the fall, as in `record_walks`
    arrays = {name: array.astype(np.float64) for name, array in arrays.items()}
    for array in arrays.values():
        array[~alive] = np.nan
    names = [f"command_{name}" for name in _COMMAND] if turning else ["command"]
    command = columns(step, names, slice(count))
    command = command if turning else command[:, 0]
    arrays |= {"command": command, "alive": alive}
    return Walks(**{name: array[:, None] for name, array in arrays.items()})


def _odometry(series: Series) -> dict[str, np.ndarray]:
    """Odometry at each instant of a log, in the frame of the topic."""
    return {
        name: series.vector(name, "wxyz" if size == 4 else "xyz")
        for name, size in ODOMETRY_SIZES.items()
    }


def _from_start(truth: Series) -> dict[str, np.ndarray]:
    """Odometry at each instant of a log, in the heading frame of its first instant."""
    rows = {name: torch.from_numpy(values) for name, values in _odometry(truth).items()}
    rows["slope"] = rows["ground_height"] = torch.zeros_like(rows["pelvis_position"][:, :1])
    first = {name: value[:1] for name, value in rows.items()}
    turned = in_heading_frame(rows, true_heading(first), start_of(first))
    return {name: value.numpy() for name, value in turned.items()}
