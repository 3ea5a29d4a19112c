"""The folder of a training run: settings, logs, checkpoints that resume.

    config.json         settings, as the recipe's dataclass has them, and transforms
    progress.csv        one row an update
    tensorboard/        the same for TensorBoard
    checkpoints/        the last three, each a ZIP archive without pickle
    policy.zip          what `aslip.load_policy` reads

Files are written under a temporary name and renamed, but for the CSV, which grows by whole rows.

A full disk does not end a training: it goes on with a warning, the checkpoints on disk stay as they
are, rows wait in memory, and each of the next ones is another attempt. Only if the last checkpoint
cannot be written the run ends with an error.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import math
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter
from torchrl import torchrl_logger

try:
    import resource
except ImportError:  # not on Windows
    resource = None

from aslip.errors import AslipError, ConfigurationError, FileDamagedError
from aslip.files.writing import replacing
from aslip.policy import POLICY_FILE
from aslip.training.checkpoint import load_checkpoint, save_checkpoint, snapshot
from aslip.training.settings import SETTINGS_FILE, read_settings, settings_text

_PROGRESS_FILE = "progress.csv"
_KEPT_CHECKPOINTS = 3
_DAMAGED = ".damaged"

# settings that may differ between a run and its continuation
_MAY_DIFFER = ("resume", "out", "total_steps", "schedule_steps", "checkpoint_minutes")
# an error names so many that may not, and so much of their texts
_SHOWN, _SHOWN_TEXT = 4, 60


class TrainingStoppedError(AslipError, RuntimeError):
    """A training that could not go on, or whose last checkpoint could not be written."""


class TrainingRun:
    """A run in a folder of its own.

    Args:
        folder: made if need be.
        config: a frozen dataclass of settings.
        resume: continue the run in the folder instead of starting one there.
        transforms: what the environment is made of, name -> text; kept with the settings.
        go_on: how to resume the run, such as a command line; for messages.

    Raises:
        ConfigurationError: the folder holds a checkpoint and `resume` is not set; or there is
            nothing to resume; or settings or transforms differ from the run's; or the folder
            cannot be written to.
        FileDamagedError: the settings of the run in the folder cannot be read.
    """

    def __init__(
        self,
        folder: Path,
        config: Any,
        *,
        resume: bool,
        transforms: Mapping[str, str] | None = None,
        go_on: str = "resume=True",
    ) -> None:
        self.folder = Path(folder)
        self.settings = json.loads(json.dumps(dataclasses.asdict(config), default=str))
        self.transforms = dict(transforms or {})
        self.go_on = go_on
        self.changes: list[str] = []
        """Settings that a resumed run has from now on, such as `total_steps 100 -> 200`."""
        self._csv = self.folder / _PROGRESS_FILE
        self._rows = ""  # not in the file yet
        self._tensorboard: SummaryWriter | None = None
        self._state: tuple[int, dict[str, Any], dict[str, Any]] | None = None
        self._saved = -1  # policy steps of the newest checkpoint
        try:
            self._open(self.folder / SETTINGS_FILE, resume)
        except OSError as error:
            raise ConfigurationError(
                f"{str(self.folder)!r} cannot be written to ({error}); give another folder with"
                " --out"
            ) from error

    @property
    def policy_file(self) -> Path:
        """Where the run's policy belongs."""
        return self.folder / POLICY_FILE

    # ------------------------------------------------------------------- logs

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """Add a row to the CSV and a point to each TensorBoard curve."""
        if not self._rows and not self._csv.exists():
            self._rows = ",".join(["step", *scalars]) + "\n"
        self._rows += ",".join([str(step), *(f"{value:.6g}" for value in scalars.values())]) + "\n"
        try:
            self._write_rows()
            if self._tensorboard is None:
                # points that a resumed run writes again are dropped
                folder = str(self.folder / "tensorboard")
                self._tensorboard = SummaryWriter(folder, purge_step=step)
            for name, value in scalars.items():
                self._tensorboard.add_scalar(name, value, step)
        except OSError as error:
            # a writer that has failed once fails for good
            self._tensorboard = None
            torchrl_logger.warning(f"a row of the logs could not be written ({error})")

    def history(self) -> dict[str, list[float]]:
        """The CSV's columns; empty if there is none yet."""
        return read_progress(self.folder)

    # ------------------------------------------------------------ checkpoints

    @contextmanager
    def saving(
        self, components: Mapping[str, Any], minutes: float
    ) -> Iterator[Callable[[int, Mapping[str, Any]], None]]:
        """Save checkpoints in the body of a `with`, and in the end, whatever ends it.

        Yields a function `keep(step, metadata)`, to be called after each update: it copies the
        states of the components, and writes them if it is time. What ends the body in the middle of
        an update, Ctrl-C, SIGTERM or an error, has the last copy written. Ctrl-C and SIGTERM say on
        standard error what they stop, what is saved, and how to go on.

        Args:
            components: name -> what has `state_dict` and `load_state_dict`.
            minutes: between checkpoints.

        Raises:
            KeyboardInterrupt: Ctrl-C, after the last checkpoint is written.
            SystemExit: SIGTERM, likewise; with its exit status, 143.
            TrainingStoppedError: the body raised something; or the last checkpoint could not be
                written.
        """
        last = -math.inf

        def keep(step: int, metadata: Mapping[str, Any]) -> None:
            nonlocal last
            self._state = step, {**metadata, "step": step}, snapshot(components)
            if time.monotonic() - last >= 60 * minutes:
                if error := self._save():
                    torchrl_logger.warning(f"{_unsaved(step, error)}; training goes on")
                last = time.monotonic()

        cause: Exception | None = None
        unsaved: OSError | None = None
        stopping = False
        try:
            with sigterm_exits():
                yield keep
        except (KeyboardInterrupt, SystemExit):
            stopping = True
            _say(f"stopping: saving the run in {str(self.folder)!r}")
            raise
        except Exception as error:
            torchrl_logger.error("training stopped", exc_info=error)
            cause = error
        finally:
            unsaved = self._save()
            if stopping:
                _say(self._interrupted(unsaved))
        if cause or unsaved:
            raise TrainingStoppedError(self._stopped_by(cause, unsaved)) from cause or unsaved

    def restore(self, components: Mapping[str, Any]) -> dict[str, Any] | None:
        """Load the newest intact checkpoint into the components, and forget what came after it.

        Returns:
            What was kept with it, and `step`; None if the run was stopped before there was any,
            which is not an error: it begins anew.

        Raises:
            FileDamagedError: there are checkpoints, but none is intact.
        """
        damaged: dict[Path, FileDamagedError] = {}
        for path in reversed(self._checkpoints()):
            try:
                metadata = load_checkpoint(path, components)
            except FileDamagedError as error:
                torchrl_logger.warning(f"{error}; falling back to the checkpoint before it")
                damaged[path] = error
                continue
            # out of the way of those to come; only now, as all may be damaged by a mistake
            for other in damaged:
                other.replace(other.with_name(other.name + _DAMAGED))
            self._saved = int(metadata["step"])
            self._forget_after(self._saved)
            return metadata
        if damaged:
            reasons = "; ".join(map(str, damaged.values()))
            raise FileDamagedError(
                f"{str(self.folder)!r} has no checkpoint to resume from: {reasons}"
            )
        torchrl_logger.warning(f"{str(self.folder)!r} has no checkpoint yet; it begins anew")
        self._forget_after(-1)
        return None

    def close(self) -> None:
        """Finish the logs."""
        if self._tensorboard is not None:
            self._tensorboard.close()

    # ---------------------------------------------------------------- private

    def _open(self, settings_file: Path, resume: bool) -> None:
        if not resume and self._holds_something(settings_file):
            raise ConfigurationError(
                f"{str(self.folder)!r} holds a run already; continue it with --resume, or give"
                " another folder with --out"
            )
        if resume:
            self._check_settings()
        self._checkpoint_folder.mkdir(parents=True, exist_ok=True)
        write_text(settings_file, settings_text(self.settings, self.transforms))
        # what a killed process was writing
        for unfinished in self._checkpoint_folder.glob(".checkpoint-*"):
            shutil.rmtree(unfinished) if unfinished.is_dir() else unfinished.unlink()

    def _holds_something(self, settings_file: Path) -> bool:
        """Whether the folder has what a new run would overwrite, of a run or of something else."""
        if self._checkpoints() or self.policy_file.exists() or self._csv.exists():
            return True
        if not settings_file.exists():
            return False
        # a run that ended before its first checkpoint leaves its settings alone
        try:
            return not self.settings.keys() <= json.loads(settings_file.read_text()).keys()
        except (ValueError, AttributeError):
            return True

    @property
    def _checkpoint_folder(self) -> Path:
        return self.folder / "checkpoints"

    def _checkpoints(self) -> list[Path]:
        """Files of checkpoints, oldest first: names sort by step."""
        return sorted(self._checkpoint_folder.glob("checkpoint-*.torchrl"))

    def _save(self) -> OSError | None:
        """Write what was kept last, unless it is written; returns why it could not be."""
        if self._state is None or self._state[0] == self._saved:
            return None
        step, metadata, states = self._state
        try:
            # or a resumed run would lack them
            self._write_rows()
            if self._tensorboard is not None:
                self._tensorboard.flush()
            path = self._checkpoint_folder / f"checkpoint-{step:012d}.torchrl"
            save_checkpoint(path, states, metadata)
            self._saved = step
            for old in self._checkpoints()[:-_KEPT_CHECKPOINTS]:
                old.unlink()
        except OSError as error:
            return error
        return None

    def _interrupted(self, unsaved: OSError | None) -> str:
        """A message that says where a run was stopped, what is saved, and how to go on."""
        if unsaved is not None:
            return self._stopped_by(None, unsaved)
        told = f"interrupted before the first update of {str(self.folder)!r}: nothing to save"
        if self._saved >= 0:
            file = str(self._checkpoints()[-1])
            told = f"interrupted after {self._saved} policy steps; saved in {file!r}"
        return f"{told}\nto go on: {self.go_on}"

    def _stopped_by(self, cause: Exception | None, unsaved: OSError | None) -> str:
        """A message that says why, where it stopped, and what can be resumed."""
        step = 0 if self._state is None else self._state[0]
        reasons = [f"training stopped after {step} policy steps"]
        if cause is not None:
            reasons[0] += f" by {type(cause).__name__}: {cause}"
        if unsaved is not None:
            reasons.append(_unsaved(step, unsaved))
        newest = "no checkpoint" if self._saved < 0 else f"the checkpoint of {self._saved} steps"
        return f"{'; '.join(reasons)}; --resume goes on from {newest} in {str(self.folder)!r}"

    def _write_rows(self) -> None:
        """Append rows to the CSV, all or none.

        Raises:
            OSError: they could not be written, and wait.
        """
        if not self._rows:
            return
        with self._csv.open("ab", buffering=0) as file:
            before, rows = file.tell(), self._rows.encode()
            try:
                if (file.write(rows) or 0) < len(rows):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._csv))
            except OSError:
                file.truncate(before)
                raise
        self._rows = ""

    def _check_settings(self) -> None:
        old, transforms = read_settings(self.folder)
        differing = _differences(old, self.settings, _MAY_DIFFER)
        # runs of before have not told what they are made of
        if transforms and self.transforms:
            differing += _differences(transforms, self.transforms)
        if differing:
            more = len(differing) - _SHOWN
            told = [*differing[:_SHOWN], *([f"and {more} more"] if more > 0 else [])]
            raise ConfigurationError(
                f"the run in {str(self.folder)!r} has other settings: {'; '.join(told)}; leave out"
                " what differs to resume it, or start another run with --out"
            )
        self.changes = [
            f"{name} {old[name]} -> {self.settings[name]}"
            for name in sorted(set(_MAY_DIFFER) & old.keys() & self.settings.keys())
            if name not in ("resume", "out") and old[name] != self.settings[name]
        ]

    def _forget_after(self, step: int) -> None:
        """Drop rows that the resumed run will write again, and what is damaged."""
        if not self._csv.exists():
            return
        lines = self._csv.read_text(errors="replace").splitlines(keepends=True)
        kept = [line for line in lines[1:] if (row := _row(line, lines[0])) and row[0] <= step]
        if kept:
            write_text(self._csv, "".join(lines[:1] + kept))
        else:
            self._csv.unlink()


def _differences(
    old: Mapping[str, Any], new: Mapping[str, Any], may_differ: Sequence[str] = ()
) -> list[str]:
    """Sentences about each name whose values differ; long texts from where they do."""
    told = []
    for name in sorted(old.keys() | new.keys()):
        if name not in may_differ and old.get(name) != new.get(name):
            before, now = repr(old.get(name)), repr(new.get(name))
            pairs = enumerate(zip(before, now, strict=False))
            same = next((i for i, (a, b) in pairs if a != b), 0)
            told.append(f"{name} was {_shown(before, same)} and is {_shown(now, same)}")
    return told


def _shown(text: str, same: int) -> str:
    """Part of a long text that begins shortly before the first difference."""
    if len(text) <= _SHOWN_TEXT:
        return text
    start = max(0, same - _SHOWN_TEXT // 2)
    end = start + _SHOWN_TEXT
    return f"{'...' if start else ''}{text[start:end]}{'...' if end < len(text) else ''}"


def _unsaved(step: int, error: OSError) -> str:
    return f"the checkpoint of {step} policy steps could not be written ({error})"


def _say(message: str) -> None:
    """Print to standard error, below a progress bar that may be there."""
    print(f"\n{message}", file=sys.stderr, flush=True)


@contextmanager
def sigterm_exits() -> Iterator[None]:
    """Have SIGTERM, with which clusters announce the end, raise SystemExit."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def read_progress(folder: Path) -> dict[str, list[float]]:
    """Columns of a run's `progress.csv`; empty if there is none yet.

    Raises:
        FileDamagedError: a line is not numbers.
    """
    path = folder / _PROGRESS_FILE
    if not path.exists():
        return {}
    lines = path.read_text(errors="replace").splitlines(keepends=True)
    # a run that was killed, or writes at this moment, may have an unfinished last row
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
    """Policy steps that a run has done.

    Raises:
        FileDamagedError: as `read_progress`.
    """
    steps = read_progress(folder).get("step")
    return int(steps[-1]) if steps else 0


def _row(line: str, header: str) -> list[float] | None:
    """Numbers of a whole line of `progress.csv`."""
    cells = line.strip().split(",")
    if not line.endswith("\n") or len(cells) != header.count(",") + 1:
        return None
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None


def peak_memory() -> float:
    """The most memory this process has held [GiB]; NaN where the system does not tell."""
    # getrusage on Linux counts what the process was forked from, too
    with contextlib.suppress(OSError):
        status = Path("/proc/self/status").read_text()
        if peak := re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE):
            return int(peak[1]) / 2**20
    if resource is None:
        return math.nan
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # bytes on macOS, kibibytes elsewhere
    return peak / 2**30 if sys.platform == "darwin" else peak / 2**20


def write_text(path: Path, text: str) -> None:
    """Write a file as a whole or not at all."""
    with replacing(path) as file:
        file.write(text.encode())
