"""Look a reference motion up by phase and command.

Guarantees: the reference is continuous in phase and command, periodic and once continuously
differentiable in phase, and linear along each axis of the command between neighbouring motions. At
the command of a motion and the phase of a sample it is that sample.
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
from aslip.robot import CASSIE, SIDES, Robot
from aslip.rom.gait import Gait
from aslip.rom.motion import PHASE_SAMPLES, Motion

SHIPPED = ("gaits", "single_reference")
"""Names of shipped libraries."""


@dataclass(frozen=True)
class Reference:
    """Reference motion at one instant, walking frame: x forward, y left, z up; batch shape b.

    Body and feet are the reduced-order model's. The body is mapped to the pelvis origin, a foot to
    the centre of the sole.
    """

    motor_position: Tensor
    """(*b, 10) motor angles of the inverse kinematics [rad]."""
    motor_velocity: Tensor
    """(*b, 10) motor velocities [rad/s]."""
    motor_torque: Tensor
    """(*b, 10) joint torques that balance the model's leg forces [N m]."""
    body_position: Tensor
    """(*b, 3) forward deviation from uniform motion at the mean speed, sway, height above ground
    [m]. Public code lets x grow over a stride and jump back to 0; we subtract uniform motion so
    that the reference is continuous."""
    body_velocity: Tensor
    """(*b, 3) [m/s]."""
    left_foot_position: Tensor
    """(*b, 3) sole centre minus body [m]."""
    left_foot_velocity: Tensor
    """(*b, 3) velocity over ground, zero in stance [m/s]."""
    right_foot_position: Tensor
    """(*b, 3) sole centre minus body [m]."""
    right_foot_velocity: Tensor
    """(*b, 3) velocity over ground, zero in stance [m/s]."""

    def to_tensordict(self) -> TensorDict:
        """Convert to a tensordict with one entry per field."""
        entries = {field.name: getattr(self, field.name) for field in fields(self)}
        return TensorDict(entries, batch_size=self.motor_position.shape[:-1])


class GaitLibrary(nn.Module):
    """Motions over a grid of commands, with their inverse kinematics.

    A module without parameters: tables are buffers, which move to another device with `to` and are
    left out of `state_dict`, because they come from a file. Environments may share a library.

    Args:
        motions: motions in order of the table's commands.
        table: table of the motions, from `tabulate`.
        made_by: origin, such as the command and package versions; saved in the file.

    Raises:
        ConfigurationError: commands of the motions are not those of the table.
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
                f"commands of motions must be those of the table, {table.commands.tolist()}, got"
                f" {commands}"
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
        robot: Robot = CASSIE,
        *,
        samples: int = PHASE_SAMPLES,
        torque_jumps: bool = False,
        made_by: Mapping[str, str] | None = None,
    ) -> GaitLibrary:
        """Tabulate motions and make a library of them.

        Arguments and errors are those of `tabulate` and of the class.
        """
        from aslip.library.tabulate import tabulate

        table = tabulate(motions, robot, samples=samples, torque_jumps=torque_jumps)
        return cls(motions, table, made_by=made_by)

    @classmethod
    def load(cls, path: str | Path = "gaits", robot: Robot = CASSIE) -> GaitLibrary:
        """Read a library.

        Args:
            path: file, or name of a shipped library: "gaits", the 21 optimal gaits of the paper, or
                "single_reference", the motion of the single-reference baseline.
            robot: robot of the library.

        Raises:
            AssetError: there is no such file.
            FileDamagedError: the file is truncated, altered, or no gait library.
        """
        file = asset_path(f"{path}.npz") if path in SHIPPED else Path(path)
        motions, table, made_by = read_library(file, robot)
        return cls(motions, table, made_by=made_by)

    def save(self, path: str | Path) -> None:
        """Write motions and table; `load` returns the same bits.

        Motions other than optimal gaits are loaded as `aslip.rom.SampledMotion`.

        Args:
            path: file to write; an existing one is replaced as a whole.

        Raises:
            OSError: the file cannot be written; an existing one is unchanged.
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
            ConfigurationError: a motion is not an optimal gait; `motions` has all motions.
        """
        gaits = tuple(motion for motion in self.motions if isinstance(motion, Gait))
        if len(gaits) < len(self.motions):
            kinds = sorted({type(motion).__name__ for motion in self.motions})
            raise ConfigurationError(
                f"motions must be optimal gaits, got motions of type {', '.join(kinds)}"
            )
        return gaits

    def check_speed(self, speed: float) -> float:
        """Check that the library covers a speed, and return it.

        Raises:
            SpeedOutOfRangeError: the speed is outside the library.
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

        Interpolation is cubic in phase and multilinear in the command. Phase wraps; commands are
        clamped to the range of the library.

        Args:
            phase: (*b, 1) stride fraction; 0 is left lift-off.
            command: (*b, c) one value per axis of the grid; today forward speed [m/s], c = 1.

        Returns:
            Reference with batch shape b, single precision.

        Raises:
            ShapeError: an argument is not a tensor of its shape.
        """
        values = self._interpolate(self._reference, phase, command).float()
        return Reference(*values.split(self._widths, dim=-1))

    def stride(self, command: Tensor) -> Tensor:
        """Duration of a stride [s], (*b, 1); multilinear between motions, clamped outside."""
        _check_width("command", command, len(self.table.axes))
        motion, weights = self._grid.corners(command)
        return multilinear(self._strides[motion], weights).to(command.dtype)

    def initial_state(self, phase: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """Configuration and velocity of a robot on the reference.

        Args:
            phase: (*b, 1) stride fraction.
            command: (*b, c) as in `lookup`.

        Returns:
            `qpos` (*b, 35) and `qvel` (*b, 32), double precision, MuJoCo's conventions; the pelvis
            is at x = 0. Between motions, interpolation opens the loops by a fraction of a
            millimetre.
        """
        qpos = self._interpolate(self._qpos, phase, command)
        for quaternion in self.table.robot.indices.quaternions:
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
