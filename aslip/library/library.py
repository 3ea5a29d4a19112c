"""Look a reference motion up by phase and speed.

Guarantees: continuous in phase and speed, periodic and once continuously differentiable in phase,
linear in speed between neighbouring gaits; at a gait's own speed and a stored phase it returns what
was stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from scipy.interpolate import CubicSpline, PchipInterpolator
from tensordict import TensorDict
from torch import Tensor

from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.files.assets import asset_path
from aslip.library.file import GaitTable, read_library
from aslip.rom import Gait

GAITS_ASSET = "gaits.npz"


@dataclass(frozen=True)
class Reference:
    """One instant of a gait, in the walking frame: x forward, y left, z up, batch shape b.

    Body and feet are the reduced-order model's. The body is mapped to the pelvis origin, a foot to
    the centre of the sole.
    """

    motor_position: Tensor
    """(*b, 10) motor angles of the inverse kinematics [rad]."""
    motor_velocity: Tensor
    """(*b, 10) their rates [rad/s]."""
    motor_torque: Tensor
    """(*b, 10) torques at the joints, with which legs carry what the model's do [N m]."""
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
        """The same as a tensordict, one entry a field."""
        entries = {field.name: getattr(self, field.name) for field in fields(self)}
        return TensorDict(entries, batch_size=self.motor_position.shape[:-1])


class GaitLibrary:
    """Optimal walking gaits over speed, with their inverse kinematics.

    Args:
        gaits: the gaits in order of speed.
        table: the gaits sampled at equal steps of phase, with the robot's configuration.
        torque_jumps: whether motor torques jump between samples, as when a pendulum changes its
            stance foot; they are then interpolated such that they never overshoot the samples.

    Raises:
        ConfigurationError: there are gaits, but of other speeds than the table's.
    """

    def __init__(
        self, gaits: Sequence[Gait], table: GaitTable, *, torque_jumps: bool = False
    ) -> None:
        self.gaits = tuple(gaits)
        speeds = [gait.speed for gait in gaits]
        if speeds and speeds != table.speeds.tolist():
            raise ConfigurationError(
                f"gaits must be those of the table's speeds, {table.speeds.tolist()} m/s, got"
                f" {len(speeds)} of {speeds} m/s"
            )
        self.table = table
        columns = {field.name: getattr(table, field.name) for field in fields(Reference)}
        self._widths = [column.shape[-1] for column in columns.values()]
        jumps = np.repeat(
            [torque_jumps and name == "motor_torque" for name in columns], self._widths
        )
        self._reference = _PeriodicTable(
            np.concatenate(list(columns.values()), axis=-1), table.speeds, jumps
        )
        self._qpos = _PeriodicTable(table.qpos, table.speeds)
        self._qvel = _PeriodicTable(table.qvel, table.speeds)
        self._strides = torch.tensor(table.strides)

    @classmethod
    def load(cls, path: str | Path | None = None) -> GaitLibrary:
        """Read a library; by default the one that ships with the package.

        Raises:
            AssetError: there is no such file.
            FileDamagedError: the file is truncated, altered, or no gait library.
        """
        return cls(*read_library(asset_path(GAITS_ASSET) if path is None else Path(path)))

    @property
    def speeds(self) -> np.ndarray:
        """(g,) speeds of the gaits [m/s], ascending, read-only."""
        return self.table.speeds

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

    def lookup(self, phase: Tensor, speed: Tensor) -> Reference:
        """Reference motion at a point of the stride (Sec. III-A).

        Between samples: cubic in phase, linear in speed. Phase wraps. A speed outside the library
        is clamped to its range, so that a command from a joystick can do no harm.

        Args:
            phase: (*b, 1) stride fraction; 0 is left lift-off.
            speed: (*b, 1) commanded forward speed [m/s].

        Returns:
            Reference with batch shape b, single precision.

        Raises:
            ShapeError: one is no tensor of such a shape.
        """
        for name, value in (("phase", phase), ("speed", speed)):
            if not isinstance(value, Tensor) or value.shape[-1:] != (1,):
                got = tuple(value.shape) if isinstance(value, Tensor) else value
                raise ShapeError(f"{name} must be a tensor of shape (..., 1), got {got!r}")
        values = self._reference(phase, speed).float()
        return Reference(*values.split(self._widths, dim=-1))

    def stride(self, speed: Tensor) -> Tensor:
        """Duration of a stride [s], shape of `speed`; linear between gaits, clamped outside."""
        row, weight = self._reference.locate_speed(speed)
        return torch.lerp(self._strides[row], self._strides[row + 1], weight).to(speed.dtype)

    def initial_state(self, phase: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        """The robot's configuration and velocity on the reference.

        Args:
            phase: (*b, 1) stride fraction.
            speed: (*b, 1) forward speed [m/s].

        Returns:
            `qpos` (*b, 35) and `qvel` (*b, 32), double precision, MuJoCo's conventions; the pelvis
            is at x = 0. At a speed between two gaits the loops close to a fraction of a millimetre.
        """
        qpos = self._qpos(phase, speed)
        for quaternion in self.table.quaternions:
            qpos[..., quaternion] = torch.nn.functional.normalize(qpos[..., quaternion], dim=-1)
        return qpos, self._qvel(phase, speed)


class _PeriodicTable:
    """(g, m, k) samples over speed and phase, interpolated; phase k of m is at k / m.

    Columns (k,) with `jumps` are monotone between samples, the others twice differentiable.
    """

    def __init__(
        self, values: np.ndarray, speeds: np.ndarray, jumps: np.ndarray | None = None
    ) -> None:
        samples = values.shape[1]
        closed = np.concatenate([values, values[:, :1]], axis=1)
        spline = CubicSpline(np.arange(samples + 1), closed, axis=1, bc_type="periodic")
        slopes = spline(np.arange(samples), 1)
        if jumps is not None and jumps.any():
            around = np.concatenate([values[:, -1:], closed], axis=1)[..., jumps]
            monotone = PchipInterpolator(np.arange(-1, samples + 1), around, axis=1)
            slopes[..., jumps] = monotone(np.arange(samples), 1)
        # (g, m, 2, k): value and slope per sample, gathered together
        self._nodes = torch.as_tensor(np.stack([values, slopes], axis=2), dtype=torch.float64)
        self._speeds = torch.as_tensor(np.array(speeds), dtype=torch.float64)

    def locate_speed(self, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Row below a speed, and the weight of the row above; shapes of `speed`."""
        speed = speed.double().clamp(self._speeds[0], self._speeds[-1])
        # of so few gaits, counting those below is faster than a search
        row = (speed.unsqueeze(-1) >= self._speeds[1:-1]).sum(-1)
        low, high = self._speeds[row], self._speeds[row + 1]
        return row, (speed - low) / (high - low)

    def __call__(self, phase: Tensor, speed: Tensor) -> Tensor:
        row, weight = self.locate_speed(speed)
        samples = self._nodes.shape[1]
        position = (phase.double() % 1.0) * samples
        left = position.floor()
        t = position - left
        column = left.long().squeeze(-1) % samples
        after = (column + 1) % samples
        row = row.squeeze(-1)
        low = _hermite(self._at(row, column), self._at(row, after), t)
        high = _hermite(self._at(row + 1, column), self._at(row + 1, after), t)
        return torch.lerp(low, high, weight)

    def _at(self, row: Tensor, column: Tensor) -> Tensor:
        """(*b, 2, k) nodes; selecting whole rows is several times faster than indexing twice."""
        index = row * self._nodes.shape[1] + column
        nodes = self._nodes.flatten(0, 1).index_select(0, index.flatten())
        return nodes.reshape(*index.shape, *nodes.shape[1:])


def _hermite(left: Tensor, right: Tensor, t: Tensor) -> Tensor:
    """Cubic through two (*b, 2, k) nodes of value and slope, at t (*b, 1) in [0, 1]."""
    step = right[..., 0, :] - left[..., 0, :]
    a = left[..., 1, :] - step
    b = step - right[..., 1, :]
    return left[..., 0, :] + t * (step + (1 - t) * ((1 - t) * a + t * b))
