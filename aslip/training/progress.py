"""Progress of a training: counts, one row of numbers per update, log files and progress bar."""

from __future__ import annotations

import errno
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torchrl import torchrl_logger
from torchrl.record.loggers import Logger

from aslip.base.assets import user_path
from aslip.base.imports import extras
from aslip.base.writing import replacing
from aslip.errors import FileDamagedError
from aslip.training.loggers import RunTensorboard, log_film, open_logger
from aslip.training.settings import LoggerName

with extras():
    from tqdm import tqdm

_PROGRESS_FILE = "progress.csv"

_EPISODES = 256  # number of last episodes in the means
_PACE_SECONDS = 60.0  # time over which the pace is measured
# without the time of tqdm, whose pace is a mean over displays; at most 80 columns
_BAR = "{percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt}{postfix}"


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
        # elapsed time and policy steps at the ends of the last updates
        self._marks = deque([(self.elapsed, self.step)])
        self._bar: tqdm | None = None

    @property
    def finished(self) -> bool:
        """True after the last update."""
        return self.step >= self.asked

    @property
    def elapsed(self) -> float:
        """Duration of the training without interruptions [s]."""
        return time.perf_counter() - self._start

    @property
    def pace(self) -> float:
        """Policy steps a second over the last minute, or over the last update if it took longer."""
        (before, first), (now, last) = self._marks[0], self._marks[-1]
        return (last - first) / (now - before) if now > before else math.nan

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
        self._bar = tqdm(
            total=self.total, initial=self.step, bar_format=_BAR, unit_scale=True,
            dynamic_ncols=True,
        )  # fmt: skip
        self._marks = deque([(self.elapsed, self.step)])
        for data in batches:
            # only simulated robots can diverge
            diverged = data.get(("next", "truth", "diverged"), None)
            self._divergences += 0 if diverged is None else int(diverged.sum())
            yield data

    def add(self, data: TensorDict) -> None:
        """Count the policy steps and episodes of a batch after its update."""
        self.step += data.numel()
        # the length of episodes truncated by `StaggeredEnds` means nothing
        done = (data["next", "done"] & (data.get("stagger", 0) != 1))[..., 0]
        lengths = data["next", "step_count"][..., 0][done].tolist()
        totals = data["next", "episode_reward"][..., 0][done].tolist()
        self._episodes.extend(zip(lengths, totals, strict=True))
        self._marks.append((self.elapsed, self.step))
        while len(self._marks) > 2 and self._marks[1][0] < self.elapsed - _PACE_SECONDS:
            self._marks.popleft()
        if self._bar is not None:
            length, total = self._episode_means()
            left = timedelta(seconds=round((self.total - self.step) / self.pace))
            about = f"{left} left, {self.pace:.0f}/s, length {length:.0f}, return {total:.0f}"
            self._bar.n = self.step
            self._bar.set_postfix_str(about)

    def _episode_means(self) -> list[float]:
        """Mean length and return of the last episodes."""
        return torch.tensor(self._episodes or [(0.0, 0.0)]).mean(0).tolist()

    def row(self, data: TensorDict, losses: Mapping[str, float]) -> dict[str, float]:
        """Numbers to log after an update.

        Args:
            data: the batch.
            losses: means of the update.
        """
        length, total = self._episode_means()
        terms = {name: float(term.mean()) for name, term in data["next", "reward_terms"].items()}
        return {
            "elapsed_s": self.elapsed,
            "steps_per_second": self.pace,
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

    Benchmarks read the CSV, and resuming cuts it to the checkpoint. TorchRL's CSV logger is not
    used for it, because it writes a file per number.

    Args:
        folder: folder of the run.
        logger: TorchRL logger that gets all rows, or a name of `LoggerName`, whose logger gets
            settings and films, too.
    """

    def __init__(self, folder: Path, logger: Logger | LoggerName = "none") -> None:
        self._folder = folder
        self.path = folder / _PROGRESS_FILE
        self._rows = ""  # rows not yet in the file
        self._kind = logger if isinstance(logger, str) else "none"
        self._logger = None if isinstance(logger, str) else logger
        self._settings: dict[str, Any] = {}
        self._tensorboard: RunTensorboard | None = None
        self._films = self._kind != "none"

    def open(self, settings: Mapping[str, Any], resume: bool = False) -> None:
        """Open the logger that was given by name, and give it the settings.

        Raises:
            MissingExtraError: its library is not installed.
        """
        plain = (int, float, str)  # others are refused by TensorBoard
        self._settings = {k: v if isinstance(v, plain) else str(v) for k, v in settings.items()}
        if self._kind not in ("none", "tensorboard"):
            self._logger = open_logger(self._kind, self._folder, resume)
            self._logger.log_hparams(self._settings)

    def write(self, step: int, scalars: Mapping[str, float]) -> None:
        """Add a row; on a full disk, warn and keep it for the next attempt."""
        if not self._rows and not self.path.exists():
            self._rows = ",".join(["step", *scalars]) + "\n"
        self._rows += ",".join([str(step), *(f"{value:.6g}" for value in scalars.values())]) + "\n"
        try:
            self._append_rows()
            if self._tensorboard is None:
                self._tensorboard = RunTensorboard(self._folder, step)
                if self._kind == "tensorboard":
                    self._tensorboard.log_hparams(self._settings)
            self._tensorboard.log_metrics(dict(scalars), step)
        except OSError as error:
            # a writer keeps failing after its first failure
            self._tensorboard = None
            torchrl_logger.warning(f"a row of the logs could not be written ({error})")
        if self._logger is not None:
            try:
                self._logger.log_metrics(dict(scalars), step)
            except Exception as error:  # such as a server that cannot be reached
                torchrl_logger.warning(f"{self._logger} did not take a row ({error})")

    def film(self, step: int, draw: Callable[[Path], tuple[np.ndarray, float]]) -> None:
        """Give a film to the logger that was given by name; after a failure there are no more.

        Args:
            step: policy steps.
            draw: function that writes a film to a path, and returns its pictures (n, height, width,
                3) and their number per second.
        """
        logger = self._tensorboard if self._kind == "tensorboard" else self._logger
        if not self._films or logger is None:
            return
        path = self._folder / "films" / f"{step:012d}.mp4"
        try:
            log_film(logger, step, path, *draw(path))
        except Exception as error:  # of OpenGL, or of the logger's library
            self._films = False
            torchrl_logger.warning(f"there are no films of this training ({error})")

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
        """Close TensorBoard, and the logger that was given by name."""
        for logger in (self._tensorboard, None if self._kind == "none" else self._logger):
            if logger is not None:
                logger.close()


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
