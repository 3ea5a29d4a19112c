"""Look a reference motion up by phase and command.

Guarantees: the reference is continuous in phase and command, periodic and once continuously
differentiable in phase, and linear along each axis of the command between neighbouring motions. At
the command of a motion and the phase of a sample it equals that sample, up to the error of a table
of low rank.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import numpy as np
import torch
from torch import Tensor, nn

from aslip.base.assets import asset_path, user_path
from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.library.file import read_library, write_library
from aslip.library.lookup import TableLookup
from aslip.library.low_rank import LowRankTable
from aslip.library.reference import COLUMNS, Reference
from aslip.library.region import describe, listed
from aslip.library.table import GaitTable
from aslip.library.transitions import HALF, Transitions, TransitionTable, WalkMode
from aslip.robot import CASSIE, SIDES, Robot
from aslip.rom.gait import Gait
from aslip.rom.motion import PHASE_SAMPLES, Motion

if TYPE_CHECKING:
    from aslip.library.tabulate import BuildOptions

SHIPPED = ("gaits", "directions", "single_reference")
"""Names of shipped libraries."""

_BORDER = 1e-6  # rounding of a command at the border of a region
_JOINT = 2e-3  # largest gap between gait and transitions [m]
_PLACES = ("body_position", *(f"{side}_foot_position" for side in SIDES))


def library_file(path: str | Path) -> Path:
    """File of a library, from a path or the name of a shipped one."""
    return asset_path(f"{path}.npz") if path in SHIPPED else user_path(path)


class GaitLibrary(nn.Module):
    """Motions over a grid of commands, with their inverse kinematics.

    Module without parameters: tables are buffers, which move to another device with `to` and are
    left out of `state_dict`, because they come from a file. Environments may share a library.

    Args:
        motions: motions in order of the table's commands, or None to keep the table only.
        table: table of the motions, from `tabulate`.
        made_by: origin, such as the command and package versions; saved in the file.
        transitions: stop and start of the gait in place, from `tabulate_transitions`; without them
            a robot cannot stand.

    Raises:
        ConfigurationError: commands of the motions are not those of the table, the table lacks a
            motion amid others, or stop and start do not begin and end in the gait in place.
    """

    def __init__(
        self,
        motions: Sequence[Motion] | None,
        table: GaitTable | LowRankTable,
        *,
        made_by: Mapping[str, str] | None = None,
        transitions: TransitionTable | None = None,
    ) -> None:
        super().__init__()
        self.name = ""
        """Name or file that `load` read; empty for a library built in memory."""
        self.made_by = dict(made_by or {})
        self.motions = tuple(motions or ())
        commands = [np.asarray(motion.command).tolist() for motion in self.motions]
        expected = table.commands.tolist()
        if motions is not None and commands != expected:
            raise ConfigurationError(
                f"commands of motions must be those of the table, {listed(expected)}, got"
                f" {listed(commands)}"
            )
        self._lookup = TableLookup(table)
        self.table = self._lookup.table
        self._transitions = None
        if transitions is not None:
            self._transitions = Transitions(transitions, COLUMNS)
            self._check_joints(transitions)

    @classmethod
    def from_motions(
        cls,
        motions: Sequence[Motion],
        robot: Robot = CASSIE,
        *,
        samples: int = PHASE_SAMPLES,
        torque_jumps: bool = False,
        single_precision: bool = False,
        missing: bool = False,
        leg_dynamics: bool = False,
        rank: int | None = None,
        keep_motions: bool = True,
        made_by: Mapping[str, str] | None = None,
        transitions: TransitionTable | None = None,
        **build: Unpack[BuildOptions],
    ) -> GaitLibrary:
        """Tabulate motions and make a library of them.

        Arguments and errors are those of `tabulate` and of the class. A warning names motions whose
        positions, velocities and forces do not fit together, see `warn_of_mistakes`.

        With a `rank`, the table of more motions than that is a `LowRankTable` of so many
        components: 10 000 gaits and 192 components take 13 MB with 48 samples in single precision.
        """
        from aslip.library.tabulate import tabulate, warn_of_mistakes

        table = tabulate(
            motions,
            robot,
            samples=samples,
            torque_jumps=torque_jumps,
            single_precision=single_precision,
            missing=missing,
            leg_dynamics=leg_dynamics,
            **build,
        )
        if rank is not None and rank < len(motions):
            table = LowRankTable.of(table, rank)
        kept = motions if keep_motions else None
        library = cls(kept, table, made_by=made_by, transitions=transitions)
        warn_of_mistakes(motions, robot)
        return library

    @classmethod
    def load(cls, path: str | Path = "gaits", robot: Robot = CASSIE) -> GaitLibrary:
        """Read a library.

        Args:
            path: file, or name of a shipped library: "gaits", the 21 optimal gaits of the paper;
                "directions", gaits in all directions with stop and start; or "single_reference",
                the motion of the single-reference baseline.
            robot: robot of the library.

        Raises:
            AssetError: there is no such file.
            FileDamagedError: the file is truncated, altered, or no gait library.
        """
        motions, table, made_by, transitions = read_library(library_file(path), robot)
        library = cls(motions or None, table, made_by=made_by, transitions=transitions)
        library.name = str(path)
        return library

    def save(self, path: str | Path) -> None:
        """Write motions, table and transitions; `load` returns the same bits.

        Motions other than optimal gaits are loaded as `aslip.rom.SampledMotion`.

        Args:
            path: file to write; an existing one is replaced as a whole.

        Raises:
            OSError: the file cannot be written; an existing one is unchanged.
        """
        write_library(user_path(path), self.motions, self.table, self.made_by, self.transitions)

    @property
    def sha256(self) -> str:
        """SHA-256 of all arrays, of stop and start, too, as hexadecimal digits."""
        parts = [self.table.sha256, *([self.transitions.sha256] if self.transitions else [])]
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()

    @property
    def transitions(self) -> TransitionTable | None:
        """Stop and start, if the library has them."""
        return self._transitions.table if self._transitions else None

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
        if len(gaits) < len(self.motions) or not gaits:
            kinds = sorted({type(motion).__name__ for motion in self.motions})
            raise ConfigurationError(
                f"motions must be optimal gaits, got motions of type {', '.join(kinds) or 'none'}"
            )
        return gaits

    @property
    def command_size(self) -> int:
        """Number c of axes of a command: 1 for straight libraries, up to 3."""
        return len(self.table.axes)

    def nearest(self, command: Tensor) -> Tensor:
        """Commands (*b, c) moved into the region, as `lookup` does.

        Raises:
            ShapeError: `command` is not a tensor of that shape.
        """
        _check_width("command", command, self.command_size)
        return _in_kind_of(command, self._lookup.grid.clamp(command))

    def covers(self, command: Tensor) -> Tensor:
        """True (*b, 1) for commands (*b, c) in the region, up to rounding in single precision.

        Raises:
            ShapeError: `command` is not a tensor of that shape.
        """
        beyond = (self.nearest(command) - command).abs()
        return (beyond <= _BORDER).all(-1, keepdim=True)

    def check_command(self, command: float | Sequence[float]) -> tuple[float, ...]:
        """Check that the library covers a command, and return it.

        Args:
            command: one number per axis of the grid; a number alone for a single axis.

        Raises:
            SpeedOutOfRangeError: the command is outside the library.
            ShapeError: the command does not have one number per axis.
        """
        numbers = tuple(map(float, np.atleast_1d(np.asarray(command, dtype=float))))
        axes = self.table.axes
        if len(numbers) != len(axes):
            raise ShapeError(f"a command of this library has {len(axes)} numbers, got {command}")
        limits = zip(axes, numbers, strict=True)
        if not all(axis[0] - _BORDER <= v <= axis[-1] + _BORDER for axis, v in limits):
            bounds = f"{axes[0][0]:g} to {axes[0][-1]:g} m/s" if len(axes) == 1 else describe(axes)
            raise SpeedOutOfRangeError(f"{_named(numbers)} is outside the gait library: {bounds}")
        found = self._lookup.strides.new_tensor(numbers, dtype=torch.float64)
        nearest = self._lookup.grid.clamp(found)
        if not torch.allclose(found, nearest, rtol=0, atol=_BORDER):
            raise SpeedOutOfRangeError(
                f"{_named(numbers)} is outside the region of the gait library, which is no box;"
                f" look-ups would take {_named(nearest.tolist())} instead"
            )
        return numbers

    def lookup(self, phase: Tensor, command: Tensor, mode: Tensor | None = None) -> Reference:
        """Reference motion at a phase and a command (Sec. III-A).

        Interpolation is cubic in phase and multilinear in the command. Phase wraps; commands are
        clamped to the range of the library. Batch shapes are broadcast.

        Args:
            phase: (*b, 1) stride fraction; 0 is left lift-off.
            command: (*b, c) one value per axis of the grid: forward speed, sideways speed [m/s],
                yaw rate [rad/s].
            mode: (*b, 1) values of `WalkMode`; walking by default. In other modes, the reference is
                that of `transition`, and the command has no effect.

        Returns:
            Reference with batch shape b, single precision.

        Raises:
            ShapeError: an argument is not a tensor of its shape.
            ConfigurationError: a mode is given, and the library has no transitions.
        """
        self._check_place(phase, command)
        values = self._lookup.reference(phase, command).float()
        if mode is not None:
            other = self._changing(phase, mode).reference(phase, mode).float()
            values = torch.where(mode == WalkMode.WALK, values, other)
        return Reference.of(values, self._lookup.widths)

    def transition(self, phase: Tensor, mode: Tensor) -> Reference:
        """Reference motion of a stop, of standing or of a start.

        Args:
            phase: (*b, 1) stride fraction, which gives the foot that landed last and the progress
                of a stop or start, see `aslip.library.transitions`. Beyond its ends a transition
                holds its first or last sample.
            mode: (*b, 1) values of `WalkMode` other than walking.

        Returns:
            Reference with batch shape b, single precision.

        Raises:
            ShapeError: an argument is not a tensor of its shape.
            ConfigurationError: the library has no transitions.
        """
        values = self._changing(phase, mode).reference(phase, mode).float()
        return Reference.of(values, self._lookup.widths)

    def _changing(self, phase: Tensor, mode: Tensor) -> Transitions:
        _check_width("phase", phase, 1)
        _check_width("mode", mode, 1)
        if self._transitions is None:
            raise ConfigurationError(
                "this library has no stop and start; build one with transitions, as"
                " `aslip gaits directions` does"
            )
        return self._transitions

    def _check_joints(self, table: TransitionTable) -> None:
        """Compare stop and start, after each touchdown, with the gait in place and each other."""
        halves = self._lookup.strides.new_tensor([[0.0], [HALF]], dtype=torch.float64)
        phase = torch.cat([table.touchdown + halves, HALF - _BORDER + halves])
        in_place = halves.new_zeros(4, self.command_size)
        if not self.covers(in_place).all():
            raise ConfigurationError("stop and start need a gait in place, which the library lacks")
        stop, start = (torch.full_like(halves, mode) for mode in (WalkMode.STOP, WalkMode.START))
        gait, ends = self.lookup(phase, in_place), self.transition(phase, torch.cat([stop, start]))
        standing = table.standing + halves
        stopped, starting = self.transition(standing, stop), self.transition(standing, start)
        gaps = {
            "stop and start must join the gait of the library in place": _gap(gait, ends),
            "a start must begin where a stop ends": _gap(stopped, starting),
        }
        for demand, gap in gaps.items():
            if not gap <= _JOINT:
                raise ConfigurationError(f"{demand}, got a gap of {1e3 * gap:.3g} mm")

    def stride(self, command: Tensor) -> Tensor:
        """Duration (*b, 1) of a stride at commands (*b, c) [s], multilinear between motions.

        Commands outside the region are clamped.

        Raises:
            ShapeError: `command` is not a tensor of that shape.
        """
        _check_width("command", command, self.command_size)
        return _in_kind_of(command, self._lookup.stride(command))

    def initial_state(
        self, phase: Tensor, command: Tensor, mode: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Configuration and velocity of a robot on the reference.

        Args:
            phase: (*b, 1) stride fraction.
            command: (*b, c) as in `lookup`.
            mode: (*b, 1) as in `lookup`.

        Returns:
            `qpos` (*b, 35) and `qvel` (*b, 32), double precision, MuJoCo's conventions. The moving
            frame is the world: the pelvis is at its deviation from the mean path, with the velocity
            and yaw rate of the path. Between motions, interpolation opens the loops by a fraction
            of a millimetre.

        Raises:
            ShapeError: an argument is not a tensor of its shape.
            ConfigurationError: a mode is given, and the library has no transitions.
        """
        self._check_place(phase, command)
        qpos, qvel = (part.double() for part in self._lookup.state(phase, command))
        if mode is not None:
            state = self._changing(phase, mode).state(phase, mode)
            walks = mode == WalkMode.WALK
            qpos, qvel = (torch.where(walks, *p) for p in zip((qpos, qvel), state, strict=True))
        for quaternion in self.table.robot.indices.quaternions:
            qpos[..., quaternion] = nn.functional.normalize(qpos[..., quaternion], dim=-1)
        return qpos, qvel

    def _check_place(self, phase: Tensor, command: Tensor) -> None:
        _check_width("phase", phase, 1)
        _check_width("command", command, self.command_size)


def _check_width(name: str, value: Tensor, width: int) -> None:
    if not isinstance(value, Tensor) or value.shape[-1:] != (width,):
        got = tuple(value.shape) if isinstance(value, Tensor) else value
        raise ShapeError(f"{name} must be a tensor of shape (..., {width}), got {got!r}")


def _in_kind_of(command: Tensor, values: Tensor) -> Tensor:
    """Values in the precision of commands; in single precision for commands of whole numbers."""
    return values.to(command.dtype if command.is_floating_point() else torch.float32)


def _gap(one: Reference, other: Reference) -> float:
    """Largest distance between places of body and feet in two references [m]."""
    pairs = ((getattr(one, name), getattr(other, name)) for name in _PLACES)
    return max((first - second).norm(dim=-1).max().item() for first, second in pairs)


def _named(command: Sequence[float]) -> str:
    """Command in an error message."""
    if len(command) == 1:
        return f"speed {command[0]:g} m/s"
    return f"command ({', '.join(f'{value:.4g}' for value in command)})"
