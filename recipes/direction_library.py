r"""Build a library of gaits in all directions from an empty folder, or go on with a build.

python recipes/direction_library.py                        # 8543 gaits, in runs/directions
python recipes/direction_library.py --out runs/small --forward 0 0.5 1 --sideways 0 0.2 \
    --yaw-rates 0 0.5 --limits

The gaits to the left are solved on all cores, each from a neighbour, and those to the right are
their mirror images. Every solved gait is stored at once, so that the same command goes on after an
interruption. Gaits that do not exist, that the robot cannot reach, or whose legs come too close to
each other are left out and listed; the region stays convex, because it is an intersection of
half-spaces (`--limits`), and is cut further where a gait is missing amid others.

Stop and start of the gait in place are solved in the end, so that robots can stand.

Files of the folder: the library `gaits.npz`, the certificates of all gaits `certificates.csv`, the
picture `region.png`, and in `solved` and `rows` the gaits and their inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from aslip.rom import DIRECTION_MODEL, Objective, SlipParameters

LIMITS = (
    (1.0, 1.6, -2.1, 3.85),
    (1.0, 0.8, 2.35, 3.95),
    (-1.0, 2.3, -0.9, 2.6),
    (0.0, 0.86, -0.32, 0.745),
)


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the library."""

    out: Path = Path("runs/directions")
    """Folder of the library."""
    forward: tuple[float, ...] = (
        *(-0.8, -0.6, -0.45, -0.26, -0.08, 0.0, 0.18, 0.42, 0.69, 0.88, 1.02, 1.15, 1.26, 1.34),
        *(1.42, 1.5, 1.575, 1.645, 1.71, 1.765, 1.82, 1.865, 1.91, 1.95, 1.99, 2.03, 2.06),
        *(2.095, 2.13, 2.165, 2.2),
    )
    """Ascending forward speeds [m/s]."""
    sideways: tuple[float, ...] = (0.0, 0.07, 0.15, 0.22, 0.28, 0.34, 0.42, 0.5)
    """Sideways speeds to the left, from 0 [m/s]; those to the right are their mirror images."""
    yaw_rates: tuple[float, ...] = (
        *(0.0, 0.065, 0.15, 0.24, 0.335, 0.425, 0.52, 0.61, 0.69, 0.77, 0.86, 1.0),
    )
    """Yaw rates to the left, from 0 [rad/s]; those to the right are their mirror images."""
    limits: tuple[tuple[float, float, float, float], ...] = LIMITS
    """Half-spaces a v_x + b v_y + c w <= d, each for a command and its mirror image; the default
    ones hold the commands that Cassie reaches."""
    samples: int = 48
    """Samples of a stride."""
    model: SlipParameters = DIRECTION_MODEL
    """Model and bounds of the gaits."""
    rank: int = 192
    """Components of which motions are sums, see `aslip.library.low_rank.LowRankTable`; no more
    gaits than that are stored one by one."""
    leg_dynamics: bool = True
    """Feed the torques forward that carry and accelerate the legs, not only those that balance the
    model's leg forces."""
    objective: Objective = "mean"
    """Minimised quantity: the mean of u_l^2 + u_r^2 over the stride, or its integral."""
    workers: int | None = None
    """Number of processes, all cores by default."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import csv
import io
import time
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike
from tqdm import tqdm

from aslip.base.provenance import made_by
from aslip.base.tables import markdown
from aslip.base.writing import claimed, replacing
from aslip.library import (
    DirectionGrid,
    GaitFolder,
    GaitLibrary,
    TransitionTable,
    convex_gaits,
    solve_directions,
    tabulate_transitions,
)
from aslip.robot import SIDES
from aslip.rom import Gait, optimize_transitions
from aslip.show.gait_region import region_figure
from aslip.show.plots import save_figure

_HEADER = (
    *("forward", "sideways", "yaw_rate", "stride", "double_stance", "step_width", "cost"),
    *("kkt_residual", "max_defect", "integration_error", "margin", "iterations", "left_out"),
)


def main(config: Config) -> GaitLibrary:
    """Solve gaits, tabulate, store, draw and check; returns the library.

    Raises:
        ConfigurationError: another process works in the folder.
    """
    config.out.mkdir(parents=True, exist_ok=True)
    with claimed(config.out):
        return _build(config)


def _build(config: Config) -> GaitLibrary:
    start = time.perf_counter()
    grid = DirectionGrid(config.forward, config.sideways, config.yaw_rates, config.limits)
    store = GaitFolder(
        config.out / "solved", config.model, config.objective, samples=config.samples
    )
    gaits, missing = _solve(config, grid, store)
    _write_certificates(config.out / "certificates.csv", gaits, missing)
    save_figure(region_figure(gaits, [np.array(c) for c in missing]), config.out / "region.png")
    library = _tabulate(config, gaits)
    library.save(config.out / "gaits.npz")
    print(_summary(gaits, missing, library), _standing(library), sep="\n")
    print(f"\n{time.perf_counter() - start:.0f} s -> {config.out / 'gaits.npz'}, region.png")
    return library


_LIMITS = (3.0, 3.0, 0.02, 0.02)  # body, feet [mm], velocity [m/s], toes [rad]
_FAST = 1.6  # above it, gaits change fast over the command [m/s]

Missing = Mapping[tuple[float, ...], str]
"""Command without a gait -> the reason."""


def _solve(
    config: Config, grid: DirectionGrid, store: GaitFolder
) -> tuple[list[Gait], dict[tuple[float, ...], str]]:
    """Gaits of a convex region in order, and the commands that are left out."""
    with tqdm(total=len(grid.half), desc="gaits", unit="gait", smoothing=0.05) as bar:

        def progress(done: int, count: int, stored: bool) -> None:
            # stored gaits take no time and would spoil the estimate
            bar.initial += stored
            bar.update(done - bar.n)

        outcomes = solve_directions(grid, store, workers=config.workers, progress=progress)
    gaits, left_out = convex_gaits(grid, outcomes)
    return gaits, {tuple(grid.command(p).tolist()): why for p, why in left_out.items()}


def _tabulate(config: Config, gaits: Sequence[Gait]) -> GaitLibrary:
    with tqdm(total=len(gaits), desc="inverse kinematics", unit="gait") as bar:

        def progress(done: int, count: int) -> None:
            bar.update(done - bar.n)

        return GaitLibrary.from_motions(
            gaits,
            samples=config.samples,
            single_precision=True,
            missing=True,
            keep_motions=False,
            rank=config.rank,
            leg_dynamics=config.leg_dynamics,
            workers=config.workers,
            folder=config.out / "rows",
            progress=progress,
            made_by=made_by(("aslip", "casadi", "pin", "numpy", "scipy")),
            transitions=_transitions(config, gaits),
        )


def _transitions(config: Config, gaits: Sequence[Gait]) -> TransitionTable | None:
    """Stop and start of the gait in place, if there is one."""
    in_place = next((gait for gait in gaits if not gait.command.any()), None)
    if in_place is None:
        return None
    motions = optimize_transitions(in_place)
    return tabulate_transitions(
        in_place, motions, samples=config.samples, leg_dynamics=config.leg_dynamics
    )


def _standing(library: GaitLibrary) -> str:
    """Durations of stop and start."""
    table = library.transitions
    if table is None:
        return "no gait in place, so no stop and start"
    stop, start = table.durations
    return (
        f"stop {stop:.3f} s after a touchdown, start {start:.3f} s before a lift-off, standing at"
        f" {table.body_position[0, 0, -1, 2]:.3f} m"
    )


def _write_certificates(path: Path, gaits: Sequence[Gait], missing: Missing) -> None:
    """Write a row per command: residuals, errors and the smallest margin, or why it is left out."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(_HEADER)
    for gait in gaits:
        c = gait.certificate
        numbers = (gait.stride, gait.double_stance, gait.step_width, c.cost, c.kkt_residual)
        errors = (c.max_defect, c.integration_error, min(c.margins.values()), c.iterations)
        table.writerow([*gait.command.tolist(), *numbers, *errors, ""])
    for command, why in missing.items():
        table.writerow([*command, *[""] * (len(_HEADER) - 4), why])
    with replacing(path) as file:
        file.write(text.getvalue().encode())


def _summary(gaits: Sequence[Gait], missing: Missing, library: GaitLibrary) -> str:
    """Worst certificate, memory, and the commands that are left out with the reasons."""
    certificates = [gait.certificate for gait in gaits]
    memory = sum(buffer.nbytes for buffer in library.buffers())
    lines = [f"left out {command}: {why}" for command, why in missing.items()]
    return "\n".join(
        [
            *lines,
            f"{len(gaits)} gaits, {len(missing)} left out; largest KKT residual"
            f" {max(c.kkt_residual for c in certificates):.0e}, largest error of integration"
            f" {1e3 * max(c.integration_error for c in certificates):.4f} mm;"
            f" tables of {memory / 1e6:.1f} MB",
        ]
    )


def accuracy_table(rows: ArrayLike) -> str:
    """Table of the largest differences, and of the share of gaits within the limits.

    Args:
        rows: (n, 8) command and `differences` of each gait.
    """
    rows, cells = np.reshape(rows, (-1, 8)), []
    for name, part in (
        ("all", rows),
        (f"up to {_FAST} m/s forward", rows[rows[:, 0] <= _FAST]),
    ):
        if not len(part):
            continue
        within = (part[:, [3, 4, 5, 6]] <= _LIMITS).all(axis=1)
        worst = [f"{value:.2g}" for value in part[:, 3:].max(axis=0)]
        cells.append([name, f"{within.sum()} of {len(part)}", *worst])
    names = ("commands", "within limits", "body [mm]", "feet [mm]")
    return markdown((*names, "velocity [m/s]", "toes [rad]", "motors [rad]"), cells)


def random_commands(library: GaitLibrary, count: int, seed: int = 0) -> list[np.ndarray]:
    """Commands (3,) drawn uniformly over the region of a library."""
    low, high = np.transpose([axis[[0, -1]] for axis in library.table.axes])
    draws = torch.tensor(np.random.default_rng(seed).uniform(low, high, (20 * count, 3)))
    return [*draws[library.covers(draws)[:, 0]][:count].numpy()]


def differences(library: GaitLibrary, gait: Gait, samples: int) -> list[float]:
    """Largest differences of positions [mm], velocities [m/s] and angles [rad] over a stride.

    Compared are the samples and the instants midway between them.
    """
    exact = GaitLibrary.from_motions([gait], library.table.robot, samples=2 * samples)
    phase = torch.arange(2 * samples, dtype=torch.float64)[:, None] / (2 * samples)
    command = torch.tensor(gait.command).expand(2 * samples, 3)
    found, true = (one.lookup(phase, command) for one in (library, exact))
    worst = {n: (v - getattr(true, n)).abs().max().item() for n, v in vars(found).items()}
    position = 1e3 * max(worst[f"{side}_foot_position"] for side in SIDES)
    toes = max(worst[f"{side}_foot_heading"] for side in SIDES)
    velocity = max(worst["body_velocity"], *(worst[f"{side}_foot_velocity"] for side in SIDES))
    return [1e3 * worst["body_position"], position, velocity, toes, worst["motor_position"]]


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
