"""Progress of a training: counts, one row of numbers per update, log files and progress bar."""

from __future__ import annotations

import errno
import math
import os
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torchrl import torchrl_logger
from torchrl.record.loggers import Logger

from aslip.base.assets import user_path
from aslip.base.imports import extras
from aslip.base.writing import replacing
from aslip.errors import FileDamagedError

with extras():
    from torch.utils.tensorboard import SummaryWriter
    from tqdm import tqdm

_PROGRESS_FILE = "progress.csv"

_EPISODES = 256  # number of last episodes in the means


class Progress(AbstractContextManager[Any]):
    """Policy steps, time, episodes and divergences of a training, with a progress bar.

    Args:
        asked: policy steps to train for, rounded up to whole updates.
        samples: policy steps of an update.
        kept: `state()` of a training to resume; None for a new one.
    """

    def __init__(self, asked: int, samples: int, kept: Mapping[str, Any] | None = None) -> None:
        kept = kept or {"step": 0, "elapsed_s": 0.0, "divergences": 0, "episodes": []}
        self.asked, self.samples = asked, samples
        self.total = math.ceil(asked / samples) * samples
        """Policy steps of the whole training."""
        self.step: int = kept["step"]
        """Policy steps of all updates so far."""
        self._divergences = kept["divergences"]
        # length and return
        self._episodes = deque(map(tuple, kept["episodes"]), maxlen=_EPISODES)
        self._start = time.perf_counter() - kept["elapsed_s"]
        self._bar: tqdm | None = None

    @property
    def finished(self) -> bool:
        """True after the last update."""
        return self.step >= self.asked

    @property
    def elapsed(self) -> float:
        """Duration of the training without interruptions [s]."""
        return time.perf_counter() - self._start

    def state(self) -> dict[str, Any]:
        """State to resume from, of JSON types."""
        return {
            "step": self.step,
            "elapsed_s": self.elapsed,
            "episodes": list(self._episodes),
            "divergences": self._divergences,
        }

    def watch(self, batches: Iterable[TensorDict]) -> Iterator[TensorDict]:
        """Yield batches, and show the progress of their updates."""
        bar = tqdm(total=self.total, initial=self.step, unit="step", dynamic_ncols=True)
        self._bar = bar
        iterator = iter(batches)
        while True:
            bar.set_description("collecting", refresh=False)
            data = next(iterator, None)
            if data is None:
                return
            # only simulated robots can diverge
            diverged = data.get(("next", "truth", "diverged"), None)
            self._divergences += 0 if diverged is None else int(diverged.sum())
            bar.set_description("learning")
            yield data
            # a batch counts only after its update
            bar.update(self.step - bar.n)

    def add(self, data: TensorDict) -> None:
        """Count the policy steps and episodes of a batch after its update."""
        self.step += data.numel()
        # the length of episodes truncated by `StaggeredEnds` means nothing
        done = (data["next", "done"] & (data.get("stagger", 0) != 1))[..., 0]
        lengths = data["next", "step_count"][..., 0][done].tolist()
        totals = data["next", "episode_reward"][..., 0][done].tolist()
        self._episodes.extend(zip(lengths, totals, strict=True))

    def row(self, data: TensorDict, losses: Mapping[str, float]) -> dict[str, float]:
        """Numbers to log after an update.

        Args:
            data: the batch.
            losses: means of the update.
        """
        length, total = torch.tensor(self._episodes or [(0.0, 0.0)]).mean(0).tolist()
        terms = {name: float(term.mean()) for name, term in data["next", "reward_terms"].items()}
        if self._bar is not None:
            short = " ".join(f"{name} {value:.2f}" for name, value in terms.items())
            self._bar.set_postfix_str(f"length {length:.0f} return {total:.0f} | {short}", False)
        return {
            "elapsed_s": self.elapsed,
            "episode_length": length,
            "episode_return": total,
            **{f"term_{name}": value for name, value in terms.items()},
            **losses,
            "divergences": self._divergences,
        }

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close()


def check_rewards(data: TensorDict) -> None:
    """Check that every reward term of a batch is finite.

    Raises:
        FloatingPointError: a term is not finite.
    """
    for name, term in data["next", "reward_terms"].items():
        if not term.isfinite().all():
            raise FloatingPointError(f"the reward term {name!r} is not finite for some robots")


# ------------------------------------------------------------------------------ files


class ProgressLog:
    """Write one row of numbers per update to `progress.csv`, TensorBoard, and another logger.

    Benchmarks read the CSV, and resuming cuts it to the checkpoint. TorchRL's loggers are not used
    for these two: its CSV logger writes a file per number, and its TensorBoard logger cannot drop
    points that a resumed run writes again.

    Args:
        folder: folder of the run.
        logger: TorchRL logger, such as `get_logger("wandb", ...)`, or None.
    """

    def __init__(self, folder: Path, logger: Logger | None = None) -> None:
        self._folder = folder
        self.path = folder / _PROGRESS_FILE
        self._rows = ""  # rows not yet in the file
        self._logger = logger
        self._tensorboard: SummaryWriter | None = None

    def write(self, step: int, scalars: Mapping[str, float]) -> None:
        """Add a row; on a full disk, warn and keep it for the next attempt."""
        if not self._rows and not self.path.exists():
            self._rows = ",".join(["step", *scalars]) + "\n"
        self._rows += ",".join([str(step), *(f"{value:.6g}" for value in scalars.values())]) + "\n"
        try:
            self._append_rows()
            if self._tensorboard is None:
                folder = str(self._folder / "tensorboard")
                self._tensorboard = SummaryWriter(folder, purge_step=step)
            for name, value in scalars.items():
                self._tensorboard.add_scalar(name, value, step)
        except OSError as error:
            # a writer keeps failing after its first failure
            self._tensorboard = None
            torchrl_logger.warning(f"a row of the logs could not be written ({error})")
        if self._logger is not None:
            for name, value in scalars.items():
                self._logger.log_scalar(name, value, step)

    def flush(self) -> None:
        """Write all waiting rows.

        Raises:
            OSError: the rows cannot be written.
        """
        self._append_rows()
        if self._tensorboard is not None:
            self._tensorboard.flush()

    def _append_rows(self) -> None:
        """Append rows to the CSV, all or none.

        Raises:
            OSError: the rows cannot be written; they wait for the next attempt.
        """
        if not self._rows:
            return
        with self.path.open("ab", buffering=0) as file:
            before, rows = file.tell(), self._rows.encode()
            try:
                if (file.write(rows) or 0) < len(rows):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
            except OSError:
                file.truncate(before)
                raise
        self._rows = ""

    def forget_after(self, step: int) -> None:
        """Drop rows that the resumed run will write again, and damaged ones."""
        if not self.path.is_file():
            return
        lines = self.path.read_text(errors="replace").splitlines(keepends=True)
        kept = [line for line in lines[1:] if (row := _row(line, lines[0])) and row[0] <= step]
        if kept:
            with replacing(self.path) as file:
                file.write("".join(lines[:1] + kept).encode())
        else:
            self.path.unlink()

    def close(self) -> None:
        """Close the TensorBoard files."""
        if self._tensorboard is not None:
            self._tensorboard.close()


def read_progress(folder: Path) -> dict[str, list[float]]:
    """Columns of a run's `progress.csv` by name; empty if there is none yet.

    Args:
        folder: folder of the run.

    Raises:
        FileDamagedError: a line does not consist of numbers.
    """
    path = user_path(folder) / _PROGRESS_FILE
    if not path.is_file():
        return {}
    lines = path.read_text(errors="replace").splitlines(keepends=True)
    # a killed run, or one that is writing now, may have an unfinished last row
    if not lines or not lines[0].endswith("\n"):
        return {}
    rows = []
    for number, line in enumerate(lines[1:], 2):
        row = _row(line, lines[0])
        if row is not None:
            rows.append(row)
        elif line.endswith("\n"):
            raise FileDamagedError(f"line {number} of {str(path)!r} is damaged: {line[:60]!r}")
    return {name: [row[i] for row in rows] for i, name in enumerate(lines[0].strip().split(","))}


def steps_done(folder: Path) -> int:
    """Policy steps that a run has trained for.

    Raises:
        FileDamagedError: as in `read_progress`.
    """
    steps = read_progress(folder).get("step")
    return int(steps[-1]) if steps else 0


def _row(line: str, header: str) -> list[float] | None:
    """Numbers of a complete line of `progress.csv`."""
    cells = line.strip().split(",")
    if not line.endswith("\n") or len(cells) != header.count(",") + 1:
        return None
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None
