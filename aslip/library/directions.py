"""Gaits over a grid of directions: solved from their neighbours in parallel, kept in a folder.

    grid = DirectionGrid(forward=(0.0, 0.5, 1.0), sideways=(0.0, 0.2), yaw_rates=(0.0, 0.5))
    outcomes = solve_directions(grid, GaitFolder(Path("gaits")))
    gaits, left_out = convex_gaits(grid, outcomes)

Guarantees: each gait starts from a neighbour that the grid alone determines, so that neither
the number of processes nor an interruption changes a bit; a finished gait is stored at once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from aslip.base.archive import ArchiveFormat, as_json, from_npy, npy
from aslip.base.assets import UserPaths
from aslip.base.processes import processors, worker_pool
from aslip.base.writing import claimed
from aslip.errors import (
    ConfigurationError,
    FileDamagedError,
    GaitOptimizationError,
    SpeedOutOfRangeError,
    UnreachablePoseError,
)
from aslip.ik import Kinematics, LegClearance
from aslip.library.region import inside_hull
from aslip.library.tabulate import tabulate
from aslip.robot import CASSIE, Robot
from aslip.rom import (
    DIRECTION_MODEL,
    Gait,
    Objective,
    SlipParameters,
    mirror,
    optimize_gait,
)

Point = tuple[int, int, int]
"""Place on a grid along forward speed, sideways speed and yaw rate."""
Outcome = Gait | str
"""Gait, or the reason why there is none."""
Progress = Callable[[int, int, bool], None]
"""Function called with the numbers of finished and of all gaits, and whether the last one was read
from the folder."""

_FORMAT = ArchiveFormat("gait", 2, compressed=True)
_REASON = "reason.json"
_ROUNDING = 1e-9  # rounding of a command at the border of a region
_MIRROR = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class DirectionGrid:
    """Grid of commands, equal to its mirror image, in a convex region.

    Raises:
        ConfigurationError: an axis is empty, not finite or does not ascend, or `sideways` or
            `yaw_rates` does not begin with 0.
    """

    forward: tuple[float, ...]
    """Ascending forward speeds [m/s]."""
    sideways: tuple[float, ...]
    """Sideways speeds to the left, ascending from 0 [m/s]; the grid has those to the right, too."""
    yaw_rates: tuple[float, ...]
    """Yaw rates to the left, ascending from 0 [rad/s]; the grid has those to the right, too."""
    limits: tuple[tuple[float, float, float, float], ...] = ()
    """Numbers a, b, c [m/rad], d [m/s] of half-spaces a v_x + b v_y + c w <= d, each of which holds
    for a command and for its mirror image (v_x, -v_y, -w). An intersection of half-spaces is
    convex, and so is the region."""

    def __post_init__(self) -> None:
        """Check the axes."""
        for name in ("forward", "sideways", "yaw_rates"):
            values = getattr(self, name)
            if not (len(values) and np.isfinite(values).all()):
                raise ConfigurationError(f"{name} needs one finite value or more, got {values}")
            if name != "forward" and values[0] != 0:
                raise ConfigurationError(f"{name} must begin with 0, got {values}")
            if not (np.diff(values) > 0).all():
                raise ConfigurationError(f"{name} must ascend, got {values}")

    @property
    def axes(self) -> tuple[np.ndarray, ...]:
        """Values along each axis, both signs included."""
        sides = [np.array([*(-v for v in a[:0:-1]), *a]) for a in (self.sideways, self.yaw_rates)]
        return np.array(self.forward), *sides

    def command(self, point: Point) -> np.ndarray:
        """(3,) command at a point."""
        return np.array([axis[i] for axis, i in zip(self.axes, point, strict=True)])

    def contains(self, command: np.ndarray) -> bool:
        """True if a command and its mirror image are within the limits."""
        return all(
            np.dot(row[:3], image) <= row[3] + _ROUNDING
            for row in self.limits
            for image in (command, command * _MIRROR)
        )

    @property
    def points(self) -> list[Point]:
        """Points within the limits, in ascending order of commands."""
        every = np.ndindex(*map(len, self.axes))
        return [(i, j, k) for i, j, k in every if self.contains(self.command((i, j, k)))]

    @property
    def half(self) -> list[Point]:
        """Points to solve; the other points are their mirror images."""
        return [point for point in self.points if point >= self.image(point)]

    def image(self, point: Point) -> Point:
        """Point of the mirrored command."""
        _, sideways, yaw_rates = self.axes
        return point[0], len(sideways) - 1 - point[1], len(yaw_rates) - 1 - point[2]

    def parent(self, point: Point) -> Point | None:
        """Neighbour whose gait is the guess: less yaw, then less sidestep, then nearer to rest.

        None at the start of the tree, or where that neighbour is outside the limits.
        """
        at = list(point)
        rest = [int(np.abs(axis).argmin()) for axis in self.axes]
        for i in (2, 1, 0):
            if at[i] != rest[i]:
                at[i] -= int(np.sign(at[i] - rest[i]))
                found = (at[0], at[1], at[2])
                return found if self.contains(self.command(found)) else None
        return None


@dataclass(frozen=True)
class GaitFolder(UserPaths):
    """Folder of solved gaits, one file each, and the settings of their optimisation."""

    folder: Path
    """Folder; made when the first gait is stored."""
    model: SlipParameters = DIRECTION_MODEL
    """Model and bounds of the gaits."""
    objective: Objective = "mean"
    """Objective of the optimisation."""
    robot: Robot = CASSIE
    """Robot that must reach the poses."""
    samples: int = 48
    """Samples of a stride at which the robot must reach the poses."""
    least_clearance: float = 0.02
    """Least distance between the robot's legs [m]."""

    def file(self, command: np.ndarray, guess: Gait | None) -> Path:
        """File of a command; other settings and guesses, which may end elsewhere, have others."""
        digest = hashlib.sha256(self.robot.mjcf.read_bytes())
        poses = [self.samples, self.least_clearance]
        settings = [command.tolist(), asdict(self.model), self.objective, *poses]
        digest.update(json.dumps(settings).encode())
        for name, array in guess.to_arrays().items() if guess else ():
            if name != "certificate":  # it has the time of the solve, which varies
                digest.update(npy(array))
        return self.folder / f"{digest.hexdigest()[:32]}.npz"

    def read(self, command: np.ndarray, guess: Gait | None) -> Outcome | None:
        """Stored outcome of a command and a guess; None if there is no intact file for them."""
        file = self.file(command, guess)
        if not file.is_file():
            return None
        try:
            entries = _FORMAT.read(file)
            if _REASON in entries:
                return str(json.loads(entries[_REASON]))
            arrays = {name.removesuffix(".npy"): from_npy(data) for name, data in entries.items()}
            return Gait.from_arrays(arrays)
        except (FileDamagedError, ValueError):
            return None

    def solve(self, command: np.ndarray, guess: Gait | None) -> Outcome:
        """Optimise a gait, check the robot's poses, store and return the outcome.

        The solver starts from the guess, and from the rough one if it fails.

        Raises:
            SolverError: the solver failed by an accident; nothing is stored.
            OSError: the file cannot be written.
        """
        outcome = self._attempt(command, guess)
        if isinstance(outcome, Gait):
            entries = {f"{name}.npy": npy(array) for name, array in outcome.to_arrays().items()}
        else:
            entries = {_REASON: as_json(outcome)}
        self.folder.mkdir(parents=True, exist_ok=True)
        _FORMAT.write(self.file(command, guess), entries)
        return outcome

    def _attempt(self, command: np.ndarray, guess: Gait | None) -> Outcome:
        reason = ""
        for start in [guess, None] if guess else [None]:
            try:
                gait = optimize_gait(
                    command, parameters=self.model, guess=start, objective=self.objective
                )
                poses = tabulate([gait], self.robot, samples=self.samples).qpos[0]
            except (SpeedOutOfRangeError, UnreachablePoseError) as error:
                return str(error)
            except GaitOptimizationError as error:
                reason = str(error)
            else:
                clearance = _leg_clearance(self.robot)(poses).min()
                if clearance >= self.least_clearance:
                    return gait
                return (
                    f"legs come within {1e3 * clearance:.0f} mm of each other, at least"
                    f" {1e3 * self.least_clearance:.0f} mm are wanted"
                )
        return reason


@lru_cache(maxsize=2)
def _leg_clearance(robot: Robot) -> LegClearance:
    return LegClearance(Kinematics(robot))


def solve_directions(
    grid: DirectionGrid,
    store: GaitFolder,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> dict[Point, Outcome]:
    """Outcome at each point of a grid: a gait, or the reason why there is none.

    Half of the points are solved, or read from the folder; the others are mirror images.

    Args:
        grid: commands.
        store: folder and settings of the gaits.
        workers: number of processes, all cores by default.
        progress: called after each solved or read gait.

    Raises:
        ConfigurationError: another process solves gaits in the folder.
        SolverError: as in `GaitFolder.solve`.
        OSError: a file cannot be written.
    """
    half = grid.half
    found: dict[Point, Outcome] = {}
    store.folder.mkdir(parents=True, exist_ok=True)
    with (
        claimed(store.folder),
        worker_pool(processors() if workers is None else workers) as pool,
    ):
        for point, outcome, stored in _outcomes(grid, half, store, pool):
            found[point] = outcome
            if progress:
                progress(len(found), len(half), stored)
    images = {grid.image(point): found[point] for point in half}
    mirrored = {p: mirror(o) if isinstance(o, Gait) else o for p, o in images.items()}
    return {point: (mirrored | found)[point] for point in grid.points}


def _outcomes(
    grid: DirectionGrid, half: Sequence[Point], store: GaitFolder, pool: Executor | None
) -> Iterator[tuple[Point, Outcome, bool]]:
    """Outcomes of points as they are finished, parents first, and whether they were stored."""
    children: dict[Point | None, list[Point]] = {}
    for point in half:
        children.setdefault(grid.parent(point), []).append(point)
    ready: list[tuple[Point, Gait | None]] = [(point, None) for point in children.get(None, [])]
    running: dict[Future[Outcome], Point] = {}

    def finished(point: Point, outcome: Outcome) -> None:
        guess = outcome if isinstance(outcome, Gait) else None
        ready.extend((child, guess) for child in children.get(point, []))

    while ready or running:
        while ready:
            point, guess = ready.pop(0)
            command = grid.command(point)
            outcome = store.read(command, guess)
            stored = outcome is not None
            if outcome is None and pool:
                running[pool.submit(store.solve, command, guess)] = point
                continue
            if outcome is None:
                outcome = store.solve(command, guess)
            finished(point, outcome)
            yield point, outcome, stored
        for task in wait(running, return_when=FIRST_COMPLETED).done:
            point, outcome = running.pop(task), task.result()
            finished(point, outcome)
            yield point, outcome, False


def convex_gaits(
    grid: DirectionGrid, outcomes: Mapping[Point, Outcome]
) -> tuple[list[Gait], dict[Point, str]]:
    """Gaits over a convex region in order of the grid, and the reason why others are left out.

    A gap amid the gaits is cut off by a plane through its command and by the mirror image of the
    plane. Candidates are planes along the limits, along the axes and across the direction from
    rest; the one that costs the fewest gaits is taken.

    Raises:
        ConfigurationError: there is no gait, or the gaits that are left span no volume.
    """
    if not outcomes:
        raise ConfigurationError(f"no command of the grid is within the limits {grid.limits}")
    points = list(outcomes)
    wide = [i for i, axis in enumerate(grid.axes) if len(axis) > 1]
    commands = np.array([grid.command(point) for point in points])
    solved = np.array([isinstance(outcomes[point], Gait) for point in points])
    if not solved.any():
        why = f"at {grid.command(points[0]).tolist()}: {outcomes[points[0]]}"
        raise ConfigurationError(f"there is no gait at any of the {len(points)} commands; {why}")
    kept = solved.copy()
    while not kept.all() and (holes := inside_hull(commands[:, wide], kept)).any():
        sizes = np.linalg.norm(commands / _extent(grid), axis=1)
        hole = commands[holes][sizes[holes].argmin()]
        kept &= ~_smallest_cut(grid, commands, kept, hole)
    gaits, left_out = [], {}
    for point, keep in zip(points, kept, strict=True):
        outcome = outcomes[point]
        if isinstance(outcome, str):
            left_out[point] = outcome
        elif keep:
            gaits.append(outcome)
        else:
            left_out[point] = "solved, but outside the convex region"
    return gaits, left_out


def _smallest_cut(
    grid: DirectionGrid, commands: np.ndarray, kept: np.ndarray, hole: np.ndarray
) -> np.ndarray:
    """Mask of the commands on or beyond the best plane through a hole, or beyond its image."""
    normals = [*(np.array(row[:3]) for row in grid.limits), hole / _extent(grid) ** 2, *np.eye(3)]
    normals = [n * s for n in normals for s in ([1, 1, 1], [1, -1, -1], [-1, -1, -1], [-1, 1, 1])]
    cuts = []
    for normal in normals:
        level = normal @ hole - _ROUNDING
        if level > 0:  # rest stays
            images = commands, commands * _MIRROR
            cuts.append(np.logical_or(*(image @ normal >= level for image in images)))
    if not cuts:
        raise ConfigurationError("a library needs a gait at rest, there is none at (0, 0, 0)")
    return min(cuts, key=lambda cut: np.count_nonzero(cut & kept))


def _extent(grid: DirectionGrid) -> np.ndarray:
    """Largest value along each axis, and 1 for an axis of zeros."""
    largest = np.array([np.abs(axis).max() for axis in grid.axes])
    return np.where(largest > 0, largest, 1.0)
