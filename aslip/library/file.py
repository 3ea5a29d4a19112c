"""The gait library's file: arrays, and how they were made; NumPy reads it, too."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from aslip.errors import AssetError, ConfigurationError, ShapeError
from aslip.files.archive import ArchiveFormat, as_json, from_npy, npy
from aslip.robot import CASSIE
from aslip.rom import Gait

FORMAT = ArchiveFormat(
    "gait library", 3, advice="rebuild it with recipes/gait_library.py", compressed=True
)
"""Entries: `table/FIELD.npy`, `gaitNN/FIELD.npy`, `made_by.json`."""
_MADE_BY = "made_by.json"
# what cubic interpolation takes
_FEWEST_SAMPLES = 4


@dataclass(frozen=True, eq=False)
class GaitTable:
    """G gaits at m equal steps of phase, left lift-off first, and the robot on them.

    Walking frame: x forward, y left, z up. Body and feet as in `aslip.library.Reference`.
    """

    speeds: np.ndarray
    """(g,) [m/s], ascending."""
    strides: np.ndarray
    """(g,) duration of a stride [s]."""
    body_position: np.ndarray
    """(g, m, 3) x is the deviation from uniform motion [m]."""
    body_velocity: np.ndarray
    """(g, m, 3) [m/s]."""
    left_foot_position: np.ndarray
    """(g, m, 3) relative to the body [m]."""
    left_foot_velocity: np.ndarray
    """(g, m, 3) over ground [m/s]."""
    right_foot_position: np.ndarray
    """(g, m, 3) relative to the body [m]."""
    right_foot_velocity: np.ndarray
    """(g, m, 3) over ground [m/s]."""
    motor_position: np.ndarray
    """(g, m, 10) [rad]."""
    motor_velocity: np.ndarray
    """(g, m, 10) [rad/s]."""
    motor_torque: np.ndarray
    """(g, m, 10) at the joints, to carry what the legs of the model carry [N m]."""
    qpos: np.ndarray
    """(g, m, 35) configuration, pelvis x as the body's."""
    qvel: np.ndarray
    """(g, m, 32) velocity."""

    # where qpos holds unit quaternions: pelvis and both Achilles rods
    quaternions = (slice(3, 7), slice(10, 14), slice(24, 28))

    def __post_init__(self) -> None:
        """Make the arrays read-only, and check that they belong together.

        Raises:
            ConfigurationError: fewer than two speeds, speeds that do not ascend, strides that are
                not positive, or entries that are not finite.
            ShapeError: an array has another number of gaits, samples or columns, or there are fewer
                than four samples.
        """
        for field in fields(self):
            array = np.array(getattr(self, field.name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)
        if self.speeds.ndim != 1 or len(self.speeds) < 2 or not (np.diff(self.speeds) > 0).all():
            raise ConfigurationError(
                f"a library needs two or more ascending speeds, got {self.speeds.tolist()} m/s"
            )
        for field in fields(self):
            self._check(field.name)
        if not (self.strides > 0).all():
            raise ConfigurationError(f"strides must be positive, got {self.strides.tolist()} s")

    def _check(self, name: str) -> None:
        array, gaits, samples = getattr(self, name), len(self.speeds), self.qpos.shape[1:2]
        expected = (gaits,) if name in ("speeds", "strides") else (gaits, *samples, _width(name))
        if array.shape != expected or not all(n >= _FEWEST_SAMPLES for n in samples):
            raise ShapeError(
                f"{name} must have shape {expected} with {_FEWEST_SAMPLES} or more samples of a"
                f" stride, got {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ConfigurationError(f"{name} has entries that are not finite")


def _width(name: str) -> int:
    """Columns of an array of a `GaitTable` over speeds and samples."""
    robot = {"qpos": 35, "qvel": 32}
    return robot.get(name, len(CASSIE.motor_names) if name.startswith("motor") else 3)


def write_library(
    path: Path, gaits: Sequence[Gait], table: GaitTable, made_by: Mapping[str, str]
) -> None:
    """Store gaits and table.

    Args:
        path: the file; replaced as a whole.
        gaits: the gaits in order of speed.
        table: the same gaits sampled.
        made_by: the command and the versions of what made them.

    Raises:
        OSError: the file cannot be written; an older file of the name is then untouched.
    """
    arrays = {f"table/{f.name}": getattr(table, f.name) for f in fields(table)}
    for i, gait in enumerate(gaits):
        arrays |= {f"gait{i:02d}/{name}": value for name, value in gait.to_arrays().items()}
    entries = {f"{name}.npy": npy(array) for name, array in arrays.items()}
    FORMAT.write(path, {**entries, _MADE_BY: as_json(dict(made_by))})


def read_library(path: Path) -> tuple[list[Gait], GaitTable]:
    """Gaits and table of a file.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: the file is truncated, altered, or no gait library.
    """
    entries = _read(path)
    try:
        arrays = _arrays(entries)
        count = len({name.split("/")[0] for name in arrays if name.startswith("gait")})
        table = GaitTable(**{f.name: arrays[f"table/{f.name}"] for f in fields(GaitTable)})
        gaits = [Gait.from_arrays(_below(arrays, f"gait{i:02d}/")) for i in range(count)]
    except Exception as error:  # whatever a stranger's arrays are
        raise FORMAT.damaged(path, error) from error
    return gaits, table


def read_made_by(path: Path) -> dict[str, str]:
    """How a library was made: the command, and the versions of what it used.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: the file is truncated, altered, or no gait library.
    """
    entries = _read(path)
    try:
        return dict(json.loads(entries[_MADE_BY]))
    except Exception as error:  # whatever a stranger's text is
        raise FORMAT.damaged(path, error) from error


def _read(path: Path) -> dict[str, bytes]:
    """All entries of a file whose hashes are right."""
    if not path.is_file():
        raise AssetError(
            f"there is no gait library {str(path)!r}; make it with recipes/gait_library.py"
        )
    return FORMAT.read(path)


def _arrays(entries: Mapping[str, bytes]) -> dict[str, np.ndarray]:
    """Arrays by name.

    Raises:
        ValueError: one cannot be read, or has numbers that are not finite.
    """
    found = {
        name.removesuffix(".npy"): from_npy(data)
        for name, data in entries.items()
        if name.endswith(".npy")
    }
    for name, array in found.items():
        if array.dtype.kind != "U" and not np.isfinite(array).all():
            raise ValueError(f"{name!r} has entries that are not finite")
    return found


def _below(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name[len(prefix) :]: a for name, a in arrays.items() if name.startswith(prefix)}
