"""Motions on a grid of commands and phases, with the robot on them: plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE

PAPER_SPEEDS = tuple(round(0.1 * i, 1) for i in range(21))
"""Speeds of the paper's library: 0 to 2 m/s in steps of 0.1 m/s (Sec. III-A)."""

FEWEST_SAMPLES = 4
"""Fewest samples of a stride for cubic interpolation."""


@dataclass(frozen=True, eq=False)
class GaitTable:
    """Motions at all points g of a grid of commands and at m equal steps of phase.

    g stands for one axis per axis of the command, m for phases from left lift-off. Walking frame: x
    forward, y left, z up. Body and feet as in `aslip.library.Reference`. Arrays are read-only.

    Raises:
        ConfigurationError: values along an axis that do not ascend, strides that are not positive,
            or entries that are not finite.
        ShapeError: an array has another number of motions, samples or columns, or there are fewer
            than four samples.
    """

    axes: tuple[np.ndarray, ...]
    """Values of the command along each axis, ascending; the first is forward speed [m/s]."""
    strides: np.ndarray
    """(*g,) duration of a stride [s]."""
    body_position: np.ndarray
    """(*g, m, 3) x is the deviation from uniform motion [m]."""
    body_velocity: np.ndarray
    """(*g, m, 3) [m/s]."""
    foot_position: np.ndarray
    """(*g, m, 2, 3) left and right relative to the body [m]."""
    foot_velocity: np.ndarray
    """(*g, m, 2, 3) left and right over ground [m/s]."""
    motor_position: np.ndarray
    """(*g, m, 10) [rad]."""
    motor_velocity: np.ndarray
    """(*g, m, 10) [rad/s]."""
    motor_torque: np.ndarray
    """(*g, m, 10) joint torques that balance the model's leg forces [N m]."""
    qpos: np.ndarray
    """(*g, m, 35) configuration, pelvis x as the body's."""
    qvel: np.ndarray
    """(*g, m, 32) velocity."""
    torque_jumps: bool = False
    """Motor torques may jump between samples, as when a pendulum changes its stance foot; they are
    then interpolated such that they never overshoot the samples."""

    def __post_init__(self) -> None:
        """Make the arrays read-only, and check that they belong together."""
        object.__setattr__(self, "axes", tuple(_read_only(axis) for axis in self.axes))
        for name in ARRAYS:
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        self._check_axes()
        for name in ARRAYS:
            self._check(name)
        if not (self.strides > 0).all():
            raise ConfigurationError(f"strides must be positive, got {self.strides.tolist()} s")

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of commands along each axis."""
        return tuple(map(len, self.axes))

    @property
    def commands(self) -> np.ndarray:
        """(n, c) commands at all points of the grid; the last axis varies fastest."""
        mesh = np.meshgrid(*self.axes, indexing="ij")
        return np.stack([axis.ravel() for axis in mesh], axis=1)

    def _check_axes(self) -> None:
        if not self.axes or not all(
            axis.ndim == 1 and len(axis) and np.isfinite(axis).all() and (np.diff(axis) > 0).all()
            for axis in self.axes
        ):
            raise ConfigurationError(
                "each axis of a library needs ascending commands, got"
                f" {[axis.tolist() for axis in self.axes]}"
            )

    def _check(self, name: str) -> None:
        array, samples = getattr(self, name), self.qpos.shape[len(self.axes) : -1]
        inner = () if name == "strides" else (*samples, *_shape(name))
        enough = len(samples) == 1 and samples[0] >= FEWEST_SAMPLES
        if array.shape != (*self.grid, *inner) or not enough:
            raise ShapeError(
                f"{name} must have shape {(*self.grid, *inner)} with {FEWEST_SAMPLES} or more"
                f" samples of a stride, got {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ConfigurationError(f"{name} has entries that are not finite")


ARRAYS = tuple(f.name for f in fields(GaitTable) if f.name not in ("axes", "torque_jumps"))
"""Names of a table's arrays over the grid."""


def _shape(name: str) -> tuple[int, ...]:
    """Shape of one sample of an array."""
    kind = name.split("_")[0]
    if kind == "motor":
        return (len(CASSIE.motor_names),)
    shapes = {"qpos": (CASSIE.indices.num_qpos,), "qvel": (CASSIE.indices.num_qvel,)}
    return shapes.get(name, (2, 3) if kind == "foot" else (3,))


def _read_only(values: np.ndarray) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
