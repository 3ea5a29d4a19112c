"""Training loop: collects batches, logs updates, saves checkpoints, resumes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Self

import torch
from tensordict import TensorDict
from torchrl.checkpoint import GlobalRNGState

from aslip.base.processes import processors
from aslip.training.progress import Progress, check_rewards
from aslip.training.run import TrainingRun


@dataclass
class TrainingLoop:
    """Iterator over the batches of a training; made by `training_loop`."""

    run: TrainingRun
    """Folder of the run."""
    progress: Progress
    """State of the training."""
    batches: Iterator[TensorDict]
    """Batches of the collector."""
    checkpoint: Callable[[int, Mapping[str, Any]], None]
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

    def log(
        self, data: TensorDict, losses: Mapping[str, float], means: Mapping[str, float]
    ) -> None:
        """Log an update, and copy the state of the training for the next checkpoint.

        Args:
            data: the batch.
            losses: means of the update.
            means: means of an evaluation.
        """
        self.run.log(self.step, {**self.progress.row(data, losses), **means})
        self.checkpoint(self.step, self.progress.state())


@contextmanager
def training_loop(
    run: TrainingRun, components: Mapping[str, Any], settings: Any
) -> Iterator[TrainingLoop]:
    """Context that resumes, announces and saves a training, with a progress bar.

    Args:
        run: folder of the run.
        components: objects to save and restore, by name; torch's generators are added. They include
            `collector`, which is shut down at the end.
        settings: settings of the recipe: `preset`, `seed`, `resume`, `total_steps`, `samples`,
            `num_envs`, `eval_interval` and `checkpoint_minutes`.

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
    with progress, collector, run.checkpointing(components, minutes) as checkpoint:
        yield TrainingLoop(run, progress, batches, checkpoint, settings.eval_interval)
