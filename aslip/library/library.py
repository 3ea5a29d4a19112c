"""Look a reference motion up by phase and command.

Guarantees: continuous in phase and command, periodic and once continuously differentiable in phase,
linear along each axis of the command between neighbouring motions; at a motion's own command and a
stored phase the stored numbers are returned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.files.assets import asset_path
from aslip.library.file import read_library, write_library
from aslip.library.interpolation import CommandGrid, PeriodicTable, multilinear
from aslip.library.table import GaitTable
from aslip.robot import CASSIE, SIDES
from aslip.rom.gait import Gait
from aslip.rom.motion import PHASE_SAMPLES, Motion

SHIPPED = ("gaits", "single_reference")
"""Names of shipped libraries."""


@dataclass(frozen=True)
class Reference:
    """One instant of a motion, in the walking frame: x forward, y left, z up, batch shape b.

    Body and feet are the reduced-order model's. The body is mapped to the pelvis origin, a foot to
    the centre of the sole.
    """

    motor_position: Tensor
    """(*b, 10) motor angles of the inverse kinematics [rad]."""
    motor_velocity: Tensor
    """(*b, 10) their rates [rad/s]."""
    motor_torque: Tensor
    """(*b, 10) joint torques that balance the model's leg forces [N m]."""
    body_position: Tensor
    """(*b, 3) forward deviation from uniform motion at the mean speed, sway, height above ground
    [m]. Public code lets x grow from 0 to a stride and jump back; we subtract the mean motion so
    that the reference is continuous."""
    body_velocity: Tensor
    """(*b, 3) [m/s]."""
    left_foot_position: Tensor
    """(*b, 3) sole centre minus body [m]."""
    left_foot_velocity: Tensor
    """(*b, 3) velocity over ground, zero in stance [m/s]."""
    right_foot_position: Tensor
    """(*b, 3) as the left foot's."""
    right_foot_velocity: Tensor
    """(*b, 3) as the left foot's."""

    def to_tensordict(self) -> TensorDict:
        """Tensordict with one entry a field."""
        entries = {field.name: getattr(self, field.name) for field in fields(self)}
        return TensorDict(entries, batch_size=self.motor_position.shape[:-1])


class GaitLibrary(nn.Module):
    """Motions over a grid of commands, with their inverse kinematics.

    A module without parameters: tables are buffers, which move to another device with `to` and are
    left out of `state_dict`, because they come from a file. One library serves any number of
    environments.

    Args:
        motions: the motions in order of the table's commands.
        table: the motions sampled at equal steps of phase, with the robot's configuration.
        made_by: a note about its origin, such as the command and the versions; kept in its file.

    Raises:
        ConfigurationError: the motions have other commands than the table.
    """

    def __init__(
        self,
        motions: Sequence[Motion],
        table: GaitTable,
        *,
        made_by: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__()
        self.made_by = dict(made_by or {})
        self.motions = tuple(motions)
        commands = [np.asarray(motion.command).tolist() for motion in motions]
        if commands != table.commands.tolist():
            raise ConfigurationError(
                f"motions must be those of the table's commands, {table.commands.tolist()}, got"
                f" {len(commands)} of {commands}"
            )
        self.table = table
        columns = _reference_columns(table)
        self._widths = [column.shape[-1] for column in columns.values()]
        jumps = np.repeat(
            [table.torque_jumps and name == "motor_torque" for name in columns], self._widths
        )
        self._grid = CommandGrid(table.axes)
        self._reference = PeriodicTable(np.concatenate(list(columns.values()), axis=-1), jumps)
        self._qpos = PeriodicTable(_flat(table, table.qpos))
        self._qvel = PeriodicTable(_flat(table, table.qvel))
        self._strides: Tensor
        strides = torch.tensor(table.strides.reshape(-1, 1))
        self.register_buffer("_strides", strides, persistent=False)

    @classmethod
    def from_motions(
        cls,
        motions: Sequence[Motion],
        *,
        samples: int = PHASE_SAMPLES,
        torque_jumps: bool = False,
        made_by: Mapping[str, str] | None = None,
    ) -> GaitLibrary:
        """Library of motions whose inverse kinematics is solved by `tabulate`.

        Arguments and errors are those of `tabulate` and of the class.
        """
        from aslip.library.tabulate import tabulate

        table = tabulate(motions, samples=samples, torque_jumps=torque_jumps)
        return cls(motions, table, made_by=made_by)

    @classmethod
    def load(cls, path: str | Path = "gaits") -> GaitLibrary:
        """Read a library.

        Args:
            path: a file, or the name of a shipped library: "gaits", the 21 optimal gaits of the
                paper, or "single_reference", the one motion of the baseline.

        Raises:
            AssetError: there is no such file.
            FileDamagedError: the file is truncated, altered, or no gait library.
        """
        file = asset_path(f"{path}.npz") if path in SHIPPED else Path(path)
        motions, table, made_by = read_library(file)
        return cls(motions, table, made_by=made_by)

    def save(self, path: str | Path) -> None:
        """Write motions and table; `load` gives the same bits back.

        Motions other than optimal gaits come back as `aslip.rom.SampledMotion`.

        Args:
            path: the file; replaced as a whole.

        Raises:
            OSError: the file cannot be written; an older file of the name is then untouched.
        """
        write_library(Path(path), self.motions, self.table, self.made_by)

    @property
    def speeds(self) -> np.ndarray:
        """(g,) forward speeds of the grid [m/s], ascending, read-only."""
        return self.table.axes[0]

    @property
    def gaits(self) -> tuple[Gait, ...]:
        """Optimal gaits of the actuated SLIP, with forces and certificates.

        Raises:
            ConfigurationError: the library has other motions, see `motions`.
        """
        gaits = tuple(motion for motion in self.motions if isinstance(motion, Gait))
        if len(gaits) < len(self.motions):
            kinds = sorted({type(motion).__name__ for motion in self.motions})
            raise ConfigurationError(
                f"this library has no optimal gaits but motions of type {', '.join(kinds)}"
            )
        return gaits

    def check_speed(self, speed: float) -> float:
        """The speed, if the library covers it.

        Raises:
            SpeedOutOfRangeError: it does not.
        """
        low, high = self.speeds[0], self.speeds[-1]
        if not low <= speed <= high:
            raise SpeedOutOfRangeError(
                f"speed {speed:g} m/s is outside the gait library: {low:g} to {high:g} m/s"
            )
        return float(speed)

    def forward(self, phase: Tensor, command: Tensor) -> Reference:
        """Reference motion, see `lookup`."""
        return self.lookup(phase, command)

    def lookup(self, phase: Tensor, command: Tensor) -> Reference:
        """Reference motion at a point of the stride (Sec. III-A).

        Between samples: cubic in phase, multilinear in the command. Phase wraps. A command outside
        the library is clamped to its range, so that a joystick can do no harm.

        Args:
            phase: (*b, 1) stride fraction; 0 is left lift-off.
            command: (*b, c) a value per axis of the grid; today forward speed [m/s], c = 1.

        Returns:
            Reference with batch shape b, single precision.

        Raises:
            ShapeError: one is no tensor of such a shape.
        """
        values = self._interpolate(self._reference, phase, command).float()
        return Reference(*values.split(self._widths, dim=-1))

    def stride(self, command: Tensor) -> Tensor:
        """Duration of a stride [s], (*b, 1); multilinear between motions, clamped outside."""
        _check_width("command", command, len(self.table.axes))
        motion, weights = self._grid.corners(command)
        return multilinear(self._strides[motion], weights).to(command.dtype)

    def initial_state(self, phase: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """The robot's configuration and velocity on the reference.

        Args:
            phase: (*b, 1) stride fraction.
            command: (*b, c) as in `lookup`.

        Returns:
            `qpos` (*b, 35) and `qvel` (*b, 32), double precision, MuJoCo's conventions; the pelvis
            is at x = 0. Between two motions the loops close to a fraction of a millimetre.
        """
        qpos = self._interpolate(self._qpos, phase, command)
        for quaternion in CASSIE.indices.quaternions:
            qpos[..., quaternion] = nn.functional.normalize(qpos[..., quaternion], dim=-1)
        return qpos, self._interpolate(self._qvel, phase, command)

    def _interpolate(self, table: PeriodicTable, phase: Tensor, command: Tensor) -> Tensor:
        _check_width("phase", phase, 1)
        _check_width("command", command, len(self.table.axes))
        motion, weights = self._grid.corners(command)
        return multilinear(table(phase, motion), weights)


def _check_width(name: str, value: Tensor, width: int) -> None:
    if not isinstance(value, Tensor) or value.shape[-1:] != (width,):
        got = tuple(value.shape) if isinstance(value, Tensor) else value
        raise ShapeError(f"{name} must be a tensor of shape (..., {width}), got {got!r}")


def _reference_columns(table: GaitTable) -> dict[str, np.ndarray]:
    """Fields of a `Reference` by name, (n, m, k) for n points of the grid."""
    feet = {
        f"{side}_foot_{kind}": getattr(table, f"foot_{kind}")[..., i, :]
        for i, side in enumerate(SIDES)
        for kind in ("position", "velocity")
    }
    return {
        f.name: _flat(table, feet[f.name] if f.name in feet else getattr(table, f.name))
        for f in fields(Reference)
    }


def _flat(table: GaitTable, values: np.ndarray) -> np.ndarray:
    """(*g, m, k) values as (n, m, k)."""
    return values.reshape(-1, *values.shape[len(table.axes) :])
