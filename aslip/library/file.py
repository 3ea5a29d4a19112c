"""Read and write files of gait libraries; `numpy.load` opens them, too."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aslip.base.archive import ArchiveFormat, as_json, from_npy, npy
from aslip.errors import AssetError
from aslip.library.low_rank import LOW_RANK_ARRAYS, LowRankTable
from aslip.library.table import ARRAYS, GaitTable
from aslip.library.transitions import TRANSITION_ARRAYS, TransitionTable
from aslip.robot import CASSIE, Robot
from aslip.rom.gait import Gait
from aslip.rom.motion import Motion, SampledMotion

FORMAT = ArchiveFormat("gait library", 6, advice="rebuild it with: aslip gaits", compressed=True)
"""Entries: `table/FIELD.npy`, `motionNN/FIELD.npy`, `transitions/FIELD.npy`, `made_by.json`.

Headings that are 0 everywhere and the mask of a full grid are left out, and so are transitions that
a library does not have. Angles and velocities of motors are left out where they are those of the
configuration. A table of low rank has the arrays of `aslip.library.low_rank.LowRankTable`.
"""
_MADE_BY = "made_by.json"
_HEADINGS = {"body_heading": (), "foot_heading": (2,)}
_MOTORS = {"motor_position": "qpos", "motor_velocity": "qvel"}


def write_library(
    path: Path,
    motions: Sequence[Motion],
    table: GaitTable | LowRankTable,
    made_by: Mapping[str, str],
    transitions: TransitionTable | None = None,
) -> None:
    """Write motions, table and transitions.

    An optimal gait is stored unchanged, another motion as a `SampledMotion` with the number of
    samples of the table.

    Args:
        path: file to write; an existing one is replaced as a whole.
        motions: motions of the table.
        table: table of the motions.
        made_by: command and package versions that made the library.
        transitions: stop and start, if there are any.

    Raises:
        OSError: the file cannot be written; an existing one is unchanged.
    """
    arrays = _table_arrays(table)
    if table.present is not None:
        arrays["table/present"] = table.present
    arrays |= {f"table/axis{i}": axis for i, axis in enumerate(table.axes)}
    if transitions is not None:
        names = ("touchdown", "durations", *TRANSITION_ARRAYS)
        arrays |= {f"transitions/{name}": getattr(transitions, name) for name in names}
    for i, motion in enumerate(motions):
        stored = (
            motion
            if isinstance(motion, Gait | SampledMotion)
            else SampledMotion.from_motion(motion, table.samples)
        )
        arrays |= {f"motion{i:02d}/{name}": value for name, value in stored.to_arrays().items()}
    entries = {f"{name}.npy": npy(np.asarray(array)) for name, array in arrays.items()}
    FORMAT.write(path, {**entries, _MADE_BY: as_json(dict(made_by))})


def read_library(
    path: Path, robot: Robot = CASSIE
) -> tuple[list[Motion], GaitTable | LowRankTable, dict[str, str], TransitionTable | None]:
    """Read motions, table and origin of a library of a robot, and its transitions or None.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: the file is truncated, altered, or no gait library.
    """
    if not path.is_file():
        raise AssetError(f"there is no gait library {str(path)!r}; create it with: aslip gaits")
    entries = FORMAT.read(path)
    try:
        arrays = _arrays(entries)
        parts = _parts(arrays)
        table = _table(parts.pop("table"), robot)
        changes = parts.pop("transitions", None)
        if changes is None:
            transitions = None
        else:
            touchdown = float(changes.pop("touchdown"))
            transitions = TransitionTable(touchdown=touchdown, **changes)
        motions = [_motion(parts[f"motion{i:02d}"]) for i in range(len(parts))]
        made_by = dict(json.loads(entries[_MADE_BY]))
    except Exception as error:  # arrays of another kind may cause any error
        raise FORMAT.damaged(path, error) from error
    return motions, table, made_by, transitions


def _table_arrays(table: GaitTable | LowRankTable) -> dict[str, np.ndarray]:
    """Arrays of a table by name in the file, without axes and mask."""
    if isinstance(table, LowRankTable):
        return {f"table/{name}": getattr(table, name) for name in LOW_RANK_ARRAYS}
    arrays = {f"table/{name}": getattr(table, name) for name in (*ARRAYS, "torque_jumps")}
    for name in _HEADINGS:
        if not getattr(table, name).any():
            del arrays[f"table/{name}"]
    for name in _MOTORS:
        if np.array_equal(getattr(table, name), _motors(name, vars(table), table.robot)):
            del arrays[f"table/{name}"]
    return arrays


def _table(arrays: Mapping[str, np.ndarray], robot: Robot) -> GaitTable | LowRankTable:
    axes = tuple(arrays[f"axis{i}"] for i in range(sum(name.startswith("axis") for name in arrays)))
    present = arrays.get("present")
    if "coefficients" in arrays:
        given = {name: arrays[name] for name in LOW_RANK_ARRAYS}
        return LowRankTable(axes=axes, robot=robot, present=present, **given)
    qpos = arrays["qpos"]
    level = {n: np.zeros((*qpos.shape[:-1], *s), qpos.dtype) for n, s in _HEADINGS.items()}
    columns = {**level, **{name: arrays[name] for name in ARRAYS if name in arrays}}
    columns |= {name: _motors(name, columns, robot) for name in _MOTORS.keys() - columns.keys()}
    return GaitTable(
        axes=axes,
        torque_jumps=bool(arrays["torque_jumps"]),
        robot=robot,
        present=present,
        **columns,
    )


def _motors(name: str, arrays: Mapping[str, np.ndarray], robot: Robot) -> np.ndarray:
    """Angles or velocities of the motors in configurations or their velocities."""
    at = robot.indices
    columns = at.motor_qpos if name == "motor_position" else at.motor_qvel
    return arrays[_MOTORS[name]][..., columns]


def _motion(arrays: Mapping[str, np.ndarray]) -> Motion:
    kind = Gait if "certificate" in arrays else SampledMotion
    return kind.from_arrays(arrays)


def _arrays(entries: Mapping[str, bytes]) -> dict[str, np.ndarray]:
    """Arrays by name.

    Raises:
        ValueError: an array cannot be read, or has non-finite entries.
    """
    found = {
        name.removesuffix(".npy"): from_npy(data)
        for name, data in entries.items()
        if name.endswith(".npy")
    }
    for name, array in found.items():
        if array.dtype.kind != "U" and not np.isfinite(array).all():
            raise ValueError(f"{name!r} has non-finite entries")
    return found


def _parts(arrays: Mapping[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """Arrays by folder and name."""
    parts: dict[str, dict[str, np.ndarray]] = {}
    for name, array in arrays.items():
        folder, field = name.split("/")
        parts.setdefault(folder, {})[field] = array
    return parts
