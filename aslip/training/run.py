"""Folder of a training run: settings, logs, checkpoints to resume from.

    config.json         settings (fields of the recipe's dataclass), transforms and first command
    progress.csv        one row per update
    tensorboard/        the same numbers for TensorBoard
    checkpoints/        the last three, each a ZIP archive without pickle
    policy.zip          policy of the newest checkpoint, for `aslip.load_policy`
    library.npz         copy of the gaits that it follows, if they are no shipped ones
    films/              films of evaluations, with a logger that gets them

Files are written under a temporary name and renamed, but for the CSV, which grows by whole rows.

On a full disk, training continues with a warning. Rows wait in memory, and checkpoints on the disk
stay intact. The run ends with an error only if the last checkpoint cannot be written.

TorchRL's `Checkpoint` and `CheckpointRotation` (0.14.1) are not used: they keep no hashes, do not
fall back when the newest file is damaged, and read files that may hold pickles.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from torchrl import torchrl_logger
from torchrl.record.loggers import Logger

from aslip.base.assets import user_path
from aslip.base.command_line import this_command
from aslip.base.processes import signals_exit
from aslip.base.provenance import peak_memory, provenance
from aslip.base.writing import claimed, replacing
from aslip.errors import AslipError, ConfigurationError, FileDamagedError
from aslip.policy import POLICY_FILE
from aslip.training.checkpoint import load_checkpoint, save_checkpoint, snapshot
from aslip.training.progress import Progress, ProgressLog, read_progress
from aslip.training.settings import (
    SETTINGS_FILE,
    LoggerName,
    differences,
    read_settings,
    settings_text,
)

_KEPT_CHECKPOINTS = 3
_DAMAGED = ".damaged"

# settings that may change when a run is resumed
_MAY_DIFFER = (
    "resume", "out", "total_steps", "schedule_steps", "checkpoint_minutes", "num_collectors",
    "logger",
    "library",  # a file may have moved; its gaits are among the transforms
)  # fmt: skip


WritePolicy = Callable[[Mapping[str, Any], Mapping[str, Any]], None]
"""Function that writes the policy from states of the components and `Progress.state()`."""


class TrainingStoppedError(AslipError, RuntimeError):
    """Training that failed, or whose last checkpoint could not be written."""


class TrainingRun:
    """Training run in a folder of its own.

    Args:
        folder: folder of the run, created if it does not exist.
        config: frozen dataclass of settings.
        resume: continue the run in the folder instead of starting a new one.
        transforms: description of each transform of the environment, by name; saved with the
            settings.
        resume_hint: command that resumes the run, for messages.
        logger: logger that also gets all rows, see `ProgressLog`.

    Raises:
        ConfigurationError: the folder already has a run, and `resume` is not set; it has no run to
            resume; settings or transforms differ from those of the run; it is not writable; or
            another process trains in it. `MissingExtraError`: the logger's library is not
            installed.
        FileDamagedError: the settings of the run in the folder cannot be read.
    """

    def __init__(
        self,
        folder: Path,
        config: Any,
        *,
        resume: bool,
        transforms: Mapping[str, str] | None = None,
        resume_hint: str = "resume=True",
        logger: Logger | LoggerName = "none",
    ) -> None:
        self.folder = user_path(folder)
        self.settings = json.loads(json.dumps(dataclasses.asdict(config), default=str))
        self.transforms = dict(transforms or {})
        self.resume_hint = resume_hint
        self.changes: list[str] = []
        """Settings changed by resuming, such as `total_steps 100 -> 200`."""
        self.command = this_command()
        """Command that started the run."""
        # of the code that runs, whatever the checkout becomes during the training
        self._provenance = provenance()
        self._log = ProgressLog(self.folder, logger)
        self._state: tuple[int, dict[str, Any], dict[str, Any]] | None = None
        self._write_policy: WritePolicy | None = None
        self._saved = -1  # policy steps of the newest checkpoint
        try:
            with contextlib.ExitStack() as claim:
                if not resume:
                    self.folder.mkdir(parents=True, exist_ok=True)
                if self.folder.is_dir():
                    claim.enter_context(claimed(self.folder))
                self._open(self.folder / SETTINGS_FILE, resume)
                self._claim = claim.pop_all()
        except OSError as error:
            raise ConfigurationError(
                f"{str(self.folder)!r} cannot be written to ({error}); give another folder with"
                " --out"
            ) from error
        self._log.open(self.settings, resume)

    @property
    def policy_file(self) -> Path:
        """Path of the run's policy."""
        return self.folder / POLICY_FILE

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """Add a row to the logs."""
        self._log.write(step, scalars)

    def film(self, step: int, draw: Callable[[Path], tuple[np.ndarray, float]]) -> None:
        """Give a film to the logger; see `ProgressLog.film`."""
        self._log.film(step, draw)

    def history(self) -> dict[str, list[float]]:
        """Columns of the CSV; empty if there is none yet."""
        return read_progress(self.folder)

    # ------------------------------------------------------------ checkpoints

    @contextmanager
    def checkpointing(
        self,
        components: Mapping[str, Any],
        minutes: float,
        write_policy: WritePolicy | None = None,
    ) -> Iterator[Callable[..., None]]:
        """Context that writes checkpoints during a training and at its end, even after an error.

        It yields a function `checkpoint(step, metadata, due=False)`. Call it after each update: it
        copies the states of the components, and writes them if a checkpoint is due. If Ctrl-C, one
        of `aslip.base.processes.ENDINGS` or an error interrupts an update, the last copy is
        written. After Ctrl-C and signals, standard error names the saved checkpoint.

        Args:
            components: objects with `state_dict` and `load_state_dict`, by name.
            minutes: time between checkpoints that are not called due.
            write_policy: function that writes the policy of each checkpoint.

        Raises:
            KeyboardInterrupt: on Ctrl-C, after the last checkpoint is written.
            SystemExit: on a signal, after the last checkpoint is written; status 128 + number.
            TrainingStoppedError: the body raised an error, or the last checkpoint is not written.
        """
        last = -math.inf
        self._write_policy = write_policy

        def checkpoint(step: int, metadata: Mapping[str, Any], due: bool = False) -> None:
            nonlocal last
            self._state = step, {**metadata, "step": step}, snapshot(components)
            if due or time.monotonic() - last >= 60 * minutes:
                if isinstance(error := self._save(), ConfigurationError):
                    raise error
                if error:
                    torchrl_logger.warning(f"{_unsaved(step, error)}; training continues")
                last = time.monotonic()

        cause: Exception | None = None
        unsaved: Exception | None = None
        stopping = False
        with signals_exit():
            try:
                yield checkpoint
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
                    _say(self._ending(None, unsaved))
                if stopping or cause or unsaved:
                    self.close()
        if cause or unsaved:
            raise TrainingStoppedError(self._ending(cause, unsaved)) from cause or unsaved

    def restore(self, components: Mapping[str, Any]) -> dict[str, Any] | None:
        """Load the newest intact checkpoint into the components, and drop later rows of the logs.

        Returns:
            Metadata of the checkpoint, including `step`; None if the run has no checkpoint yet and
            starts from the beginning.

        Raises:
            FileDamagedError: there are checkpoints, but none is intact.
        """
        damaged: dict[Path, FileDamagedError] = {}
        for path in reversed(self._checkpoints()):
            try:
                metadata = load_checkpoint(path, components)
            except FileDamagedError as error:
                torchrl_logger.warning(f"{error}; falling back to the previous checkpoint")
                damaged[path] = error
                continue
            # renamed only now: if no file loads, the cause may be elsewhere
            for other in damaged:
                other.replace(other.with_name(other.name + _DAMAGED))
            self._saved = int(metadata["step"])
            self._log.forget_after(self._saved)
            return metadata
        if damaged:
            reasons = "; ".join(map(str, damaged.values()))
            raise FileDamagedError(
                f"{str(self.folder)!r} has no checkpoint to resume from: {reasons}"
            )
        torchrl_logger.warning(
            f"{str(self.folder)!r} has no checkpoint yet; training starts from the beginning"
        )
        self._log.forget_after(-1)
        return None

    def announcement(self, title: str, progress: Progress) -> str:
        """Message at the start: folder, length, settings, and how to stop and resume.

        Args:
            title: settings to mention.
            progress: state of the training.
        """
        plan = f"training for {progress.total} policy steps"
        if progress.finished:
            plan = f"nothing left to train after {progress.step} of {progress.asked} policy steps"
        elif progress.step:
            plan = f"continuing after {progress.step} of {progress.total} policy steps"
        about = "; ".join([f"{self.folder}: {plan}", title, *self.changes])
        return f"{about}\nCtrl-C saves and stops; to continue: {self.resume_hint}"

    def about(self, progress: Mapping[str, Any]) -> dict[str, Any]:
        """Settings, transforms, length and provenance of the training, for the policy's card.

        The command is the one that started the run, also after it was resumed.

        Args:
            progress: `Progress.state()` after the training's last update.
        """
        settings = {k: v for k, v in self.settings.items() if k not in ("out", "resume")}
        return {
            "settings": settings,
            "transforms": self.transforms,
            "steps": progress["step"],
            "seconds": round(progress["elapsed_s"]),
            **self._provenance,
            "command": self.command,
        }

    def finish(self, table: str, progress: Progress) -> None:
        """Write and print the summary, and close the logs.

        Args:
            table: table of the final evaluation.
            progress: state of the training.
        """
        footer = (
            f"{progress.step} policy steps in {progress.elapsed / 60:.1f} minutes, peak memory"
            f" {peak_memory():.2f} GiB"
        )
        write_text(self.folder / "summary.md", f"{table}\n\n{footer}\n")
        print(f"\n{table}\n\n{footer}\nresults are in {self.folder}/")
        self.close()

    def close(self) -> None:
        """Close the logs, and let other processes use the folder."""
        self._log.close()
        self._claim.close()

    # ---------------------------------------------------------------- private

    def _open(self, settings_file: Path, resume: bool) -> None:
        if not resume and self._holds_run(settings_file):
            raise ConfigurationError(
                f"{str(self.folder)!r} holds a run already; continue it with --resume, or give"
                " another folder with --out"
            )
        if resume:
            self._check_settings()
        self._checkpoint_folder.mkdir(parents=True, exist_ok=True)
        write_text(settings_file, settings_text(self.settings, self.transforms, self.command))
        # temporary files of a killed process
        for unfinished in self._checkpoint_folder.glob(".checkpoint-*"):
            shutil.rmtree(unfinished) if unfinished.is_dir() else unfinished.unlink()

    def _holds_run(self, settings_file: Path) -> bool:
        """True if the folder has files that a new run would overwrite."""
        if self._checkpoints() or self.policy_file.exists() or self._log.path.exists():
            return True
        if not settings_file.is_file():
            return False
        # a run that ended before its first checkpoint leaves only its settings
        try:
            return not self.settings.keys() <= read_settings(self.folder)[0].keys()
        except FileDamagedError:
            return True

    @property
    def _checkpoint_folder(self) -> Path:
        return self.folder / "checkpoints"

    def _checkpoints(self) -> list[Path]:
        """Checkpoints, oldest first; names sort by step."""
        return sorted(self._checkpoint_folder.glob("checkpoint-*.zip"))

    def _save(self) -> OSError | ConfigurationError | None:
        """Write the last copy if it is not on disk yet; return the error of a failed attempt.

        A `ConfigurationError` is that of a policy that cannot be saved.
        """
        if self._state is None or self._state[0] == self._saved:
            return None
        step, metadata, states = self._state
        try:
            # otherwise a resumed run would lack these rows
            self._log.flush()
            path = self._checkpoint_folder / f"checkpoint-{step:012d}.zip"
            save_checkpoint(path, states, metadata)
            if self._write_policy is not None:
                self._write_policy(states, metadata)
            self._saved = step
            for old in self._checkpoints()[:-_KEPT_CHECKPOINTS]:
                old.unlink()
        except (OSError, ConfigurationError) as error:
            return error
        return None

    def _ending(self, cause: Exception | None, unsaved: Exception | None) -> str:
        """Message at the end of an unfinished training: cause, checkpoint, and how to resume."""
        step = 0 if self._state is None else self._state[0]
        by = "" if cause is None else f" by {type(cause).__name__}: {cause}"
        failed = f"; {_unsaved(step, unsaved)}" if isinstance(unsaved, OSError) else ""
        nothing = "nothing" if self._state else "nothing, as no update was complete"
        saved = str(next(reversed(self._checkpoints()), nothing))
        return (
            f"training stopped after {step} policy steps{by}{failed}; saved: {saved}"
            f"\nto continue: {self.resume_hint}"
        )

    def _check_settings(self) -> None:
        old, transforms, self.command = read_settings(self.folder)
        differing = differences(old, self.settings, _MAY_DIFFER)
        # compare only settings that both have
        if transforms and self.transforms:
            differing += differences(transforms, self.transforms)
        if differing:
            raise ConfigurationError(
                f"the run in {str(self.folder)!r} has other settings: {'; '.join(differing)};"
                " resume it with its own settings, or start another run with --out"
            )
        self.changes = [
            f"{name} {old[name]} -> {self.settings[name]}"
            for name in sorted(set(_MAY_DIFFER) & old.keys() & self.settings.keys())
            if name not in ("resume", "out") and old[name] != self.settings[name]
        ]


def _unsaved(step: int, error: Exception) -> str:
    return f"the checkpoint of {step} policy steps could not be written ({error})"


def _say(message: str) -> None:
    """Print to standard error, below the progress bar if there is one, unless it is closed."""
    with contextlib.suppress(OSError):
        print(f"\n{message}", file=sys.stderr, flush=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with replacing(path) as file:
        file.write(text.encode())
