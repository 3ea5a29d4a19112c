"""Training loop: collects batches, logs updates, saves checkpoints, resumes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.checkpoint import GlobalRNGState

from aslip.base.processes import processors
from aslip.training.progress import Progress, check_rewards
from aslip.training.run import TrainingRun, WritePolicy


@dataclass
class TrainingLoop:
    """Iterator over the batches of a training; made by `training_loop`."""

    run: TrainingRun
    """Folder of the run."""
    progress: Progress
    """State of the training."""
    batches: Iterator[TensorDict]
    """Batches of the collector."""
    checkpoint: Callable[..., None]
    """Function of `TrainingRun.checkpointing`."""
    eval_interval: int
    """Policy steps between evaluations."""

    @property
    def step(self) -> int:
        """Policy steps of all updates so far."""
        return self.progress.step

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> TensorDict:
        if self.progress.finished:
            raise StopIteration
        data = next(self.batches)
        check_rewards(data)
        return data

    def count(self, data: TensorDict) -> None:
        """Count a batch after its update."""
        self.progress.add(data)

    @property
    def evaluates(self) -> bool:
        """True if an evaluation is due: after each `eval_interval`, and after the last update."""
        return self.step % self.eval_interval < self.progress.samples or self.progress.finished

    def film(self, draw: Callable[[Path], tuple[np.ndarray, float]]) -> None:
        """Give a film to the logger if an evaluation is due; see `ProgressLog.film`."""
        if self.evaluates:
            self.run.film(self.step, draw)

    @contextmanager
    def log(self, data: TensorDict, losses: Mapping[str, float]) -> Iterator[dict[str, float]]:
        """Context that logs an update, and copies the state of the training for a checkpoint.

        It yields the row, to which an evaluation may add its means. An interrupted evaluation does
        not lose the update.

        Args:
            data: the batch.
            losses: further numbers of the row.
        """
        row = self.progress.row(data, losses)
        try:
            yield row
        finally:
            self.run.log(self.step, row)
            self.checkpoint(self.step, self.progress.state(), due=self.evaluates)


@contextmanager
def training_loop(
    run: TrainingRun,
    components: Mapping[str, Any],
    settings: Any,
    write_policy: WritePolicy | None = None,
) -> Iterator[TrainingLoop]:
    """Context that resumes, announces and saves a training, with a progress bar.

    Args:
        run: folder of the run.
        components: objects to save and restore, by name; torch's generators are added. They include
            `collector`, which is shut down at the end.
        settings: settings of the recipe: `preset`, `seed`, `resume`, `total_steps`, `samples`,
            `num_envs`, `eval_interval` and `checkpoint_minutes`.
        write_policy: function that writes the policy, at each evaluation and checkpoint.

    Raises:
        TrainingStoppedError: as in `TrainingRun.checkpointing`.
        FileDamagedError: as in `TrainingRun.restore`.
    """
    # PyTorch counts the processors of the machine, not those of a container's quota
    torch.set_num_threads(min(torch.get_num_threads(), processors()))
    components = {**components, "rng": GlobalRNGState()}
    collector = components["collector"]
    kept = run.restore(components) if settings.resume else None
    progress = Progress(settings.total_steps, settings.samples, kept)
    title = f"preset {settings.preset}, seed {settings.seed}, {settings.num_envs} robots"
    print(run.announcement(title, progress), flush=True)
    batches = progress.watch(collector)
    minutes = settings.checkpoint_minutes
    with collector, run.checkpointing(components, minutes, write_policy) as checkpoint, progress:
        yield TrainingLoop(run, progress, batches, checkpoint, settings.eval_interval)
