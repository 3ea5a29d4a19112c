"""Tiny trainings, killed or not, and comparison of their results."""

import contextlib
import io
import json
import logging
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchrl import torchrl_logger

from aslip.training.checkpoint import load_checkpoint
from aslip.training.progress import read_progress
from recipes import ppo_aslip
from tests.helpers import TINY as TWO_UPDATES

TINY = replace(TWO_UPDATES, total_steps=512, eval_interval=400)
"""Settings of a training of eight updates with a checkpoint after each."""

PATIENCE = 120.0
"""Duration without progress after which a training counts as hung [s]."""


@contextlib.contextmanager
def quiet() -> Iterator[list[str]]:
    """Silence output and progress bars; yields the list of TorchRL's log messages."""
    messages: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    handlers = torchrl_logger.handlers[:]
    torchrl_logger.handlers[:] = [Listener()]
    silence = io.StringIO()
    try:
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
            yield messages
    finally:
        torchrl_logger.handlers[:] = handlers


class Holder:
    """Checkpoint component that accepts any state."""

    def __init__(self, state: Any = None) -> None:
        self.state = state

    def state_dict(self) -> Any:
        """Loaded state."""
        return self.state

    def load_state_dict(self, state: Any) -> None:
        """Keep a state."""
        self.state = state


def train(config: ppo_aslip.Config, **parts: Any) -> dict[str, Any]:
    """Train without printing; returns the `fingerprint`. `parts` go to `ppo_aslip.main`."""
    with quiet():
        ppo_aslip.main(config, **parts)
    return fingerprint(config.out)


def resume_training(config: ppo_aslip.Config) -> dict[str, Any]:
    """Resume a training to its end; returns the `fingerprint`."""
    return train(replace(config, resume=True))


def fingerprint(out: Path) -> dict[str, Any]:
    """Progress, last checkpoint and policy of a finished run, without wall times.

    Of the random generators only torch's counts: recipes neither seed nor use Python's and NumPy's.
    """
    progress = read_progress(out)
    del progress["elapsed_s"], progress["steps_per_second"]
    newest = max((out / "checkpoints").glob("checkpoint-*.zip"))
    generators = Holder()
    kept = load_checkpoint(newest, {"rng": generators})
    del kept["elapsed_s"]
    states = {name: crc for name, crc in _checksums(newest).items() if "rng" not in name}
    return {
        # as text, in which NaN equals NaN
        "progress": json.dumps(progress),
        "kept": kept,
        "checkpoint": newest.name,
        "states": states,
        "generator": generators.state["torch_cpu"].tolist(),
        "policy": _checksums(out / "policy.zip"),
    }


def _checksums(path: Path) -> dict[str, int]:
    """Checksums of an archive's arrays and trees, the entries without wall times."""
    with zipfile.ZipFile(path) as archive:
        infos = archive.infolist()
    return {i.filename: i.CRC for i in infos if i.filename.endswith((".npy", "tree.json"))}


_VICTIM = """
import sys, torch
from dataclasses import replace
from pathlib import Path
torch.set_num_threads(1)
from tests.training.trainings import TINY, train
train(replace(TINY, out=Path(sys.argv[1])))
"""


def kill_training(out: Path, after: int, delay: float) -> None:
    """Train in another process and kill it after a number of updates plus a delay [s].

    Raises:
        RuntimeError: the training ended or hung before the kill.
    """
    command = [sys.executable, "-c", _VICTIM, str(out)]
    victim = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until = time.monotonic() + PATIENCE
        while not (out / "config.json").exists() or count_updates(out) < after:
            if victim.poll() is not None or time.monotonic() > until:
                raise RuntimeError(f"the training in {out} ended or hung on its own")
            time.sleep(0.005)
        time.sleep(delay)
    finally:
        victim.kill()
        victim.wait()


def count_updates(out: Path) -> int:
    """Number of updates in a training's log."""
    try:
        return len(read_progress(out).get("step", ()))
    except (OSError, ValueError):  # a row is being written
        return 0
