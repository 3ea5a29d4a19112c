"""Compare look-ups of a library over three commands with gaits solved at random commands.

    python -m benchmarks.gaits.interpolation
    python -m benchmarks.gaits.interpolation --library runs/directions/gaits.npz

Each gait is solved from the straight gait of its forward speed. Differences are the largest ones
over a stride, in the moving frame; the limits are 3 mm, 0.02 m/s and 0.02 rad.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    library: str = "directions"
    """Library, shipped or a file, with gaits of the default model of
    `recipes/direction_library.py`."""
    count: int = 50
    """Number of gaits."""
    seed: int = 0
    """Seed of the commands."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import numpy as np
from tqdm import tqdm

from aslip.base.tables import markdown
from aslip.errors import GaitOptimizationError
from aslip.library import GaitLibrary
from aslip.rom import DIRECTION_MODEL, optimize_gait
from recipes.direction_library import accuracy_table, differences, random_commands


def main(config: Config) -> np.ndarray:
    """Solve gaits, compare and print; returns (n, 8) commands and differences."""
    library = GaitLibrary.load(config.library)
    rows = []
    for command in tqdm(random_commands(library, config.count, config.seed), unit="gait"):
        try:
            straight = optimize_gait([command[0], 0.0, 0.0], parameters=DIRECTION_MODEL)
            gait = optimize_gait(command, parameters=DIRECTION_MODEL, guess=straight)
        except GaitOptimizationError as error:
            print(f"left out: {error}")
            continue
        rows.append([*command, *differences(library, gait, library.table.samples)])
    found = np.reshape(rows, (-1, 8))
    print(accuracy_table(found), "", _worst(found), sep="\n")
    return found


def _worst(rows: np.ndarray) -> str:
    """Table of the commands with the largest differences of the feet."""
    worst = rows[rows[:, 4].argsort()[::-1][:5]]
    cells = [[*(f"{v:.2f}" for v in row[:3]), f"{row[4]:.1f}", f"{row[5]:.3f}"] for row in worst]
    names = ("forward", "sideways [m/s]", "yaw rate [rad/s]", "feet [mm]", "velocity [m/s]")
    return markdown(names, cells)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
