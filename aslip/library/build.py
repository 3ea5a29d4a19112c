"""Rows of a table for many motions: computed on all cores, resumed from a folder."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from aslip.base.archive import ArchiveFormat, from_npy, npy
from aslip.base.assets import user_path
from aslip.base.processes import processors, worker_pool
from aslip.errors import FileDamagedError
from aslip.ik import Kinematics
from aslip.library.rows import FramedMotion, Rows
from aslip.robot import Robot
from aslip.rom.motion import Motion

Progress = Callable[[int, int], None]
"""Function called with the numbers of finished motions and of all motions."""

ONE_PROCESS: Final = 128
"""Largest number of motions that this process works on alone by default; for fewer, other processes
do not repay the seconds of their start."""

_CHUNK = 16  # motions per task and per file
_FORMAT = ArchiveFormat("rows of a gait library", 1)


def build_rows(
    motions: Sequence[Motion],
    robot: Robot,
    phase: np.ndarray,
    *,
    leg_dynamics: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
    folder: Path | None = None,
) -> list[Rows]:
    """Rows of a table for each motion, in order.

    Args:
        motions: motions.
        robot: robot that they are mapped to.
        phase: (m,) phases of the samples.
        leg_dynamics: see `aslip.library.tabulate`.
        workers: number of processes; by default all cores for more than `ONE_PROCESS` motions.
        progress: called whenever motions are finished.
        folder: folder that keeps finished rows, one file for 16 motions. An interrupted build
            resumes from there; files of other motions or robots are not used.

    Raises:
        ConfigurationError: a stride does not end where the command leads.
        UnreachablePoseError: the robot cannot take a pose of a motion.
        OSError: a file cannot be written.
    """
    folder = user_path(folder) if folder else None
    chunks = [
        _Chunk(motions[i : i + _CHUNK], robot, phase, leg_dynamics, folder)
        for i in range(0, len(motions), _CHUNK)
    ]
    if workers is None:
        workers = processors() if len(motions) > ONE_PROCESS else 1
    found, done = {}, 0
    for i, rows in _worked(chunks, min(workers, len(chunks))):
        found[i], done = rows, done + len(rows)
        if progress:
            progress(done, len(motions))
    return [row for i in range(len(chunks)) for row in found[i]]


@dataclass(frozen=True)
class _Chunk:
    """Motions that one process works on."""

    motions: Sequence[Motion | FramedMotion]
    robot: Robot
    phase: np.ndarray
    leg_dynamics: bool
    folder: Path | None

    def portable(self) -> _Chunk:
        """Chunk that can be sent; motions of classes that other processes lack are sampled here."""
        try:
            if b"__main__" not in pickle.dumps(self.motions):
                return self
        except Exception:  # pickling raises errors of any kind
            pass
        return replace(self, motions=self._framed())

    def _framed(self) -> list[FramedMotion]:
        return [
            motion if isinstance(motion, FramedMotion) else FramedMotion.of(motion, self.phase)
            for motion in self.motions
        ]

    def rows(self) -> list[Rows]:
        """Rows of the motions, from their file if there is one."""
        framed = self._framed()
        file = self.folder and self.folder / f"{_digest(framed, self.robot, self.leg_dynamics)}.npz"
        rows = _read(file) if file else None
        if rows is None:
            kinematics = Kinematics(self.robot)
            rows = [motion.rows(kinematics, leg_dynamics=self.leg_dynamics) for motion in framed]
            if file:
                _write(file, rows)
        return rows


def _worked(chunks: Sequence[_Chunk], workers: int) -> Iterator[tuple[int, list[Rows]]]:
    """Rows of chunks by index, in the order in which they are finished."""
    with worker_pool(workers) as pool:
        if pool is None:
            yield from ((i, chunk.rows()) for i, chunk in enumerate(chunks))
            return
        tasks = {pool.submit(_Chunk.rows, chunk.portable()): i for i, chunk in enumerate(chunks)}
        for task in as_completed(tasks):
            yield tasks[task], task.result()


def _digest(motions: Sequence[FramedMotion], robot: Robot, leg_dynamics: bool) -> str:
    """Name of the file of a chunk: a hash of motions, robot and kind of torques."""
    digest = hashlib.sha256(robot.mjcf.read_bytes())
    digest.update(bytes([leg_dynamics]))
    for motion in motions:
        s = motion.sample
        for array in (
            *(motion.command, np.array(motion.stride), motion.origin, motion.toe_rate),
            *(s.body.position, s.body.velocity, s.feet.position, s.feet.velocity),
            *(s.ground_force, s.heading.angle, s.heading.rate, s.foot_heading),
        ):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def _read(file: Path) -> list[Rows] | None:
    """Rows of a chunk from its file; None if there is no intact file."""
    if not file.is_file():
        return None
    try:
        entries = _FORMAT.read(file)
    except FileDamagedError:
        return None
    rows: dict[int, Rows] = {}
    for entry, data in entries.items():
        place, name = entry.removesuffix(".npy").split("/")
        rows.setdefault(int(place), {})[name] = from_npy(data)
    return [rows[i] for i in range(len(rows))]


def _write(file: Path, rows: Sequence[Rows]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    _FORMAT.write(
        file,
        {f"{i}/{name}.npy": npy(v) for i, row in enumerate(rows) for name, v in row.items()},
    )
