"""Run folders with checkpoints of a small network."""

from dataclasses import dataclass
from pathlib import Path

import torch

from aslip.training.run import TrainingRun


@dataclass(frozen=True)
class Settings:
    out: Path
    resume: bool = False
    seed: int = 0
    total_steps: int = 100
    learning_rate: float = 1e-4


def open_run(settings: Settings, *, resume: bool = False) -> TrainingRun:
    return TrainingRun(settings.out, settings, resume=resume)


def constant_network(value: float) -> torch.nn.Linear:
    net = torch.nn.Linear(3, 2)
    torch.nn.init.constant_(net.weight, value)
    return net


def save_steps(run: TrainingRun, *steps: int) -> None:
    """Save checkpoints of a network whose weights equal the step."""
    for step in steps:
        with run.checkpointing({"net": constant_network(step)}, 0.0) as checkpoint:
            checkpoint(step, {"elapsed_s": 1.5 * step})


def checkpoints(settings: Settings) -> list[Path]:
    return sorted((settings.out / "checkpoints").iterdir())


def saved_steps(settings: Settings) -> list[int]:
    """Policy steps of the existing checkpoints."""
    return [int(path.stem.rpartition("-")[2]) for path in checkpoints(settings)]


def fail_on_full_disk(*args: object, **kwargs: object) -> None:
    raise OSError(28, "No space left on device")
