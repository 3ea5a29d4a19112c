"""The folder of a training run: settings, logs, checkpoints that resume.

    config.json         settings, as the recipe's dataclass has them
    progress.csv        one row an update
    tensorboard/        the same for TensorBoard
    checkpoints/        the newest ones, each a ZIP archive without pickle
    policy.zip          what `aslip.load_policy` reads

Files are written under a temporary name and renamed, but for the CSV, which grows by whole rows.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter
from torchrl import torchrl_logger
from torchrl.checkpoint import Checkpoint, CheckpointRotation

try:
    import resource
except ImportError:  # not on Windows
    resource = None

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.policy import POLICY_FILE, load_components, read_manifest

_PROGRESS_FILE = "progress.csv"

# settings that may differ between a run and its continuation
_MAY_DIFFER = ("resume", "out", "total_steps")


class TrainingRun:
    """A run in a folder of its own.

    Args:
        folder: made if need be.
        config: a frozen dataclass of settings.
        resume: continue the run in the folder instead of starting one there.

    Raises:
        ConfigurationError: the folder holds a checkpoint and `resume` is not set; or there is
            nothing to resume; or the settings differ from the run's.
    """

    def __init__(self, folder: Path, config: Any, *, resume: bool) -> None:
        self.folder = Path(folder)
        self.settings = json.loads(json.dumps(dataclasses.asdict(config), default=str))
        settings_file = self.folder / "config.json"
        if any((self.folder / "checkpoints").glob("checkpoint-*")) and not resume:
            raise ConfigurationError(
                f"{str(self.folder)!r} holds a run already; continue it with --resume, or give"
                " another folder with --out"
            )
        if resume:
            self._check_settings(settings_file)
        self.folder.mkdir(parents=True, exist_ok=True)
        write_text(settings_file, json.dumps(self.settings, indent=1) + "\n")
        self._rotation = CheckpointRotation(self.folder / "checkpoints", keep_last=2)
        self._tensorboard: SummaryWriter | None = None
        self._csv = self.folder / _PROGRESS_FILE
        if not resume:
            self._csv.unlink(missing_ok=True)

    @property
    def policy_file(self) -> Path:
        """Where the run's policy belongs."""
        return self.folder / POLICY_FILE

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """Add a row to the CSV and a point to each TensorBoard curve."""
        with self._csv.open("a", newline="") as file:
            writer = csv.writer(file)
            if file.tell() == 0:
                writer.writerow(["step", *scalars])
            writer.writerow([step, *(f"{value:.6g}" for value in scalars.values())])
        if self._tensorboard is None:
            # points that a resumed run writes again are dropped
            self._tensorboard = SummaryWriter(str(self.folder / "tensorboard"), purge_step=step)
        for name, value in scalars.items():
            self._tensorboard.add_scalar(name, value, step)

    def history(self) -> dict[str, list[float]]:
        """The CSV's columns; empty if there is none yet."""
        return read_progress(self.folder)

    def save(self, step: int, metadata: Mapping[str, Any], **components: Any) -> None:
        """Write a checkpoint and drop the ones before the last two."""
        checkpoint = Checkpoint(format="archive", **components)
        self._rotation.save(checkpoint, step=step, metadata=dict(metadata))

    def restore(self, **components: Any) -> dict[str, Any]:
        """Load the newest intact checkpoint into the components; return its metadata.

        Raises:
            ConfigurationError: there is no intact checkpoint.
        """
        damaged: list[str] = []
        # names sort by step; the rotation's own list leaves out what it cannot read
        for path in sorted((self.folder / "checkpoints").glob("checkpoint-*"), reverse=True):
            try:
                load_components(path, **components)
                metadata = read_manifest(path)["metadata"]
            except FileDamagedError as error:
                damaged.append(str(error))
                torchrl_logger.warning(f"{error}; falling back to the checkpoint before it")
                continue
            self._forget_after(int(metadata["step"]))
            return metadata
        raise ConfigurationError(
            f"{str(self.folder)!r} has no checkpoint to resume from{'; '.join(['', *damaged])}"
        )

    def close(self) -> None:
        """Finish the logs."""
        if self._tensorboard is not None:
            self._tensorboard.close()

    def _check_settings(self, settings_file: Path) -> None:
        if not settings_file.exists():
            raise ConfigurationError(
                f"{str(self.folder)!r} holds no run to resume; start one without --resume"
            )
        old = json.loads(settings_file.read_text())
        differing = [
            f"{name} was {old.get(name)!r} and is {self.settings.get(name)!r}"
            for name in sorted(old.keys() | self.settings.keys())
            if name not in _MAY_DIFFER and old.get(name) != self.settings.get(name)
        ]
        if differing:
            raise ConfigurationError(
                f"the run in {str(self.folder)!r} has other settings: {'; '.join(differing)}"
            )

    def _forget_after(self, step: int) -> None:
        """Drop rows that the resumed run will write again."""
        history = self.history()
        if not history:
            return
        kept = [i for i, row_step in enumerate(history["step"]) if row_step <= step]
        lines = [",".join(history)]
        lines += [",".join(f"{column[i]:.10g}" for column in history.values()) for i in kept]
        write_text(self._csv, "\n".join(lines) + "\n")


def read_progress(folder: Path) -> dict[str, list[float]]:
    """Columns of a run's `progress.csv`; empty if there is none yet."""
    file_name = folder / _PROGRESS_FILE
    if not file_name.exists():
        return {}
    with file_name.open(newline="") as file:
        header, *rows = list(csv.reader(file)) or [[]]
    # a run that was killed, or writes at this moment, may have an unfinished last row
    rows = [row for row in rows if len(row) == len(header)]
    return {name: [float(row[i]) for row in rows] for i, name in enumerate(header)}


def peak_memory() -> float:
    """The most memory this process has held [GiB]; NaN where the system does not tell."""
    if resource is None:
        return math.nan
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # bytes on macOS, kibibytes elsewhere
    return peak / 2**30 if sys.platform == "darwin" else peak / 2**20


def write_text(path: Path, text: str) -> None:
    """Write a file as a whole or not at all."""
    temporary = path.with_name(path.name + ".part")
    temporary.write_text(text)
    os.replace(temporary, path)
