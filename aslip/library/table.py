"""Table of a gait library: motions and robot configurations as plain arrays."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot

PAPER_SPEEDS = tuple(round(0.1 * i, 1) for i in range(21))
"""Speeds of the paper's library: 0 to 2 m/s in steps of 0.1 m/s (Sec. III-A)."""

FEWEST_SAMPLES = 4
"""Fewest samples of a stride for cubic interpolation."""


class CommandTable:
    """Grid of commands of a table, a convex part of which has motions."""

    axes: tuple[np.ndarray, ...]
    strides: np.ndarray
    present: np.ndarray | None

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of commands along each axis."""
        return tuple(map(len, self.axes))

    @property
    def commands(self) -> np.ndarray:
        """(n, c) commands of the motions; the last axis of the grid varies fastest."""
        mesh = np.meshgrid(*self.axes, indexing="ij")
        return np.stack([axis.ravel() for axis in mesh], axis=1)[~self.missing]

    @property
    def missing(self) -> np.ndarray:
        """(p,) True at points of the flattened grid without a motion."""
        if self.present is None:
            return np.zeros(math.prod(self.grid), dtype=bool)
        return ~self.present.ravel()

    def _check_grid(self) -> None:
        """Check the axes and the mask of motions, and make them read-only."""
        axes = tuple(read_only(axis) for axis in self.axes)
        object.__setattr__(self, "axes", axes)
        if not axes or not all(
            axis.ndim == 1 and len(axis) and np.isfinite(axis).all() and (np.diff(axis) > 0).all()
            for axis in axes
        ):
            raise ConfigurationError(
                "each axis of a gait library needs ascending commands, got"
                f" {[axis.tolist() for axis in axes]}"
            )
        if self.present is None:
            return
        present = np.array(self.present, dtype=bool)
        if present.shape != self.grid:
            raise ShapeError(f"present must have shape {self.grid}, got {present.shape}")
        if not present.any():
            raise ConfigurationError("a table needs a motion at one command or more, got none")
        present.setflags(write=False)
        object.__setattr__(self, "present", None if present.all() else present)

    def _check_arrays(self, shapes: Mapping[str, tuple[int, ...]], samples: int) -> None:
        """Make arrays of given shapes read-only, and check them and the number of samples."""
        for name, shape in shapes.items():
            array = read_only(getattr(self, name))
            object.__setattr__(self, name, array)
            if array.shape != shape or samples < FEWEST_SAMPLES:
                raise ShapeError(
                    f"{name} must have shape {shape} with {FEWEST_SAMPLES} or more samples of a"
                    f" stride, got {array.shape}"
                )
            if not np.isfinite(array).all():
                raise ConfigurationError(f"{name} has non-finite entries")
        if not (self.strides > 0).all():
            raise ConfigurationError(f"strides must be positive, got {self.strides.tolist()} s")

    def _hash(self, names: Sequence[str], start: str = "") -> str:
        """SHA-256 of arrays, mask and axes, see `hash_arrays`."""
        arrays = {**{name: getattr(self, name) for name in names}, "missing": self.missing}
        return hash_arrays(arrays | {f"axis{i}": axis for i, axis in enumerate(self.axes)}, start)


@dataclass(frozen=True, eq=False)
class GaitTable(CommandTable):
    """Motions over a grid of commands, sampled at equal steps of phase.

    In shapes, n is the number of motions, in ascending order of commands, m the number of phases,
    the first at left lift-off, and g the shape of the grid, with one axis per axis of the command.
    Moving frame, body and feet are those of `aslip.library.Reference`. Arrays are read-only, in
    double or single precision.

    Raises:
        ConfigurationError: an axis does not ascend, a stride is not positive, an entry is not
            finite, or the grid has no motions.
        ShapeError: arrays differ in their number of motions or samples, have the wrong number of
            columns, or fewer than four samples.
    """

    axes: tuple[np.ndarray, ...]
    """Values of the command along each axis, ascending: forward speed, sideways speed [m/s], yaw
    rate [rad/s]."""
    strides: np.ndarray
    """(n,) duration of a stride [s]."""
    body_position: np.ndarray
    """(n, m, 3) position: deviation from the mean path, and height [m]."""
    body_velocity: np.ndarray
    """(n, m, 3) velocity over ground [m/s]."""
    body_heading: np.ndarray
    """(n, m) deviation of the body's heading from the mean heading [rad]."""
    foot_position: np.ndarray
    """(n, m, 2, 3) left and right sole centre relative to the body [m]."""
    foot_velocity: np.ndarray
    """(n, m, 2, 3) velocity of the left and right foot over ground [m/s]."""
    foot_heading: np.ndarray
    """(n, m, 2) direction of the left and right toes, from the x axis of the frame [rad]."""
    motor_position: np.ndarray
    """(n, m, 10) motor angles [rad]."""
    motor_velocity: np.ndarray
    """(n, m, 10) motor velocities [rad/s]."""
    motor_torque: np.ndarray
    """(n, m, 10) feedforward joint torques, see `aslip.library.tabulate` [N m]."""
    qpos: np.ndarray
    """(n, m, 35) configuration, with the moving frame as the world."""
    qvel: np.ndarray
    """(n, m, 32) velocity, that of the pelvis over ground."""
    torque_jumps: bool = False
    """Motor torques may jump between samples, as at a pendulum's change of stance; they are then
    interpolated monotonically, without overshoot."""
    robot: Robot = CASSIE
    """Robot of configurations and motors."""
    present: np.ndarray | None = None
    """(*g,) True at points of the grid with a motion, everywhere by default."""

    def __post_init__(self) -> None:
        """Make the arrays read-only, and check that they fit together."""
        self._check_grid()
        motions, samples = int((~self.missing).sum()), np.shape(self.qpos)[1:-1]
        shapes = {name: (motions, *samples, *row_shape(name, self.robot)) for name in ARRAYS[1:]}
        shapes["strides"] = (motions,)
        self._check_arrays(shapes, samples[0] if len(samples) == 1 else 0)

    @property
    def samples(self) -> int:
        """Number m of samples of a stride."""
        return self.qpos.shape[1]

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of all arrays, as hexadecimal digits."""
        return self._hash(ARRAYS, f"{self.torque_jumps}")


_SETTINGS = ("axes", "torque_jumps", "robot", "present")

ARRAYS = tuple(f.name for f in fields(GaitTable) if f.name not in _SETTINGS)
"""Names of a table's arrays over motions."""


def row_shape(name: str, robot: Robot) -> tuple[int, ...]:
    """Shape of one sample of an array of a robot's table."""
    kind = name.split("_")[0]
    shapes = {
        "motor": (len(robot.motor_names),),
        "qpos": (robot.indices.num_qpos,),
        "qvel": (robot.indices.num_qvel,),
        "body": () if name == "body_heading" else (3,),
        "foot": (2,) if name == "foot_heading" else (2, 3),
    }
    return shapes[kind]


def read_only(values: np.ndarray) -> np.ndarray:
    """Read-only array in the precision of `values`; a copy, unless these are read-only already."""
    single = np.asarray(values).dtype == np.float32
    array = np.asarray(values, dtype=np.float32 if single else np.float64)
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array


def hash_arrays(arrays: Mapping[str, np.ndarray], start: str = "") -> str:
    """SHA-256 of arrays, with names, types and shapes, as hexadecimal digits.

    Args:
        arrays: the arrays by name; their order counts.
        start: text before them.
    """
    digest = hashlib.sha256(start.encode())
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
