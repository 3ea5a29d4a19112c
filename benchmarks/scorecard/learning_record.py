"""Record of learning curves: trainings as rows of one CSV file, over days and machines."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from aslip.errors import FileDamagedError
from aslip.training.run import write_text

WALKING_LENGTH: Final = 350
"""Mean episode length from which a training counts as walking, of at most 400 [policy steps]."""

ROBUST_LENGTH: Final = 390
"""Mean episode length with almost no falls, of at most 400 [policy steps]."""

LENGTHS: Final = (WALKING_LENGTH, ROBUST_LENGTH)
"""Mean episode lengths whose first policy step is reported."""

COLUMNS: Final = (
    "step", "elapsed_s", "episode_length", "episode_return", "divergences",
    "eval_return", "eval_survived",
)  # fmt: skip
"""Columns of a run's progress in the report; evaluations are NaN in rows without one."""

_HEADER = ["variant", "seed", "commit", *COLUMNS]
_THINNED = 8  # interval of rows in a record


@dataclass(frozen=True)
class Run:
    """Progress of one training."""

    variant: str
    seed: int
    commit: str
    """Commit of the code that finished the run; empty if unfinished or unknown."""
    columns: dict[str, np.ndarray]
    """Columns of the progress, by name."""

    @property
    def steps(self) -> int:
        """Number of policy steps."""
        return int(self.columns["step"][-1])

    def after(self, length: float) -> int | None:
        """First row with at least a mean episode length; None without one."""
        found = np.flatnonzero(self.columns["episode_length"] >= length)
        return int(found[0]) if len(found) else None

    def evaluations(self) -> np.ndarray:
        """Rows with an evaluation over all commands."""
        return np.flatnonzero(np.isfinite(self.columns["eval_return"]))

    def until(self, steps: int) -> Run:
        """Copy that ends with the update in which a number of policy steps is reached."""
        end = int(np.searchsorted(self.columns["step"], steps)) + 1
        return replace(self, columns={name: of[:end] for name, of in self.columns.items()})

    def thinned(self) -> Run:
        """Copy with every eighth row and the rows used by the report."""
        rows = {0, len(self.columns["step"]) - 1, *self.evaluations().tolist()}
        rows |= set(range(0, len(self.columns["step"]), _THINNED))
        rows |= {row for row in map(self.after, LENGTHS) if row is not None}
        kept = sorted(rows)
        columns = {name: column[kept] for name, column in self.columns.items()}
        return Run(self.variant, self.seed, self.commit, columns)


Runs = dict[tuple[str, int], Run]
"""(Variant, seed) -> training."""


def write_record(path: Path, runs: Runs) -> None:
    """Write runs, a line for each row of their progress."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEADER)
    for run in (runs[key] for key in sorted(runs)):
        about = [run.variant, run.seed, run.commit]
        for row in zip(*(run.columns[name] for name in COLUMNS), strict=True):
            writer.writerow([*about, *(f"{value:.7g}" for value in row)])
    write_text(path, text.getvalue())


def read_record(path: Path) -> Runs:
    """Read the runs of a record; empty without a file.

    Raises:
        FileDamagedError: the file cannot be read.
    """
    if not path.is_file():
        return {}
    rows: dict[tuple[str, int], list[dict[str, str]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, strict=True)
            if reader.fieldnames != _HEADER:
                raise ValueError(f"its columns are {reader.fieldnames}, not {_HEADER}")
            for row in reader:
                rows.setdefault((row["variant"], int(row["seed"])), []).append(row)
        runs = {}
        for (variant, seed), lines in rows.items():
            columns = {name: np.array([float(line[name]) for line in lines]) for name in COLUMNS}
            if not np.isfinite(columns["step"]).all():
                raise ValueError(f"{variant}, seed {seed}, has a step that is not finite")
            runs[variant, seed] = Run(variant, seed, lines[0]["commit"], columns)
        return runs
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        raise FileDamagedError(
            f"{str(path)!r} is not a record of learning curves ({error})"
        ) from error
