"""Faults injected on purpose, and faults survived: see `benchmarks.faults`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config:
    """Number of faults of each kind; 0 leaves a kind out."""

    numbers: int = 600
    """Robots with NaN, infinity or a huge value in their state."""
    raises: int = 10
    """Simulations that raise in the middle of a training."""
    kills: int = 20
    """Trainings killed at a random moment."""
    workers: int = 2
    """Processes of collectors killed."""
    cuts: int = 100
    """Newest checkpoints truncated at a random offset."""
    flips: int = 100
    """Newest checkpoints with a flipped bit."""
    losses: int = 10
    """Runs with all checkpoints truncated."""
    full_disks: int = 50
    """Disks that are full after a random number of bytes of a checkpoint."""
    strangers: int = 24
    """Files with a hidden program, in eight ways."""
    files: int = 1000
    """Damaged files of each kind."""
    settings: int = 1000
    """Settings of a wrong type or out of range."""
    steps: int = 1_000_000
    """Policy steps of random actions."""
    robots: int = 256
    """Robots of a training whose checkpoints are timed."""
    seed: int = 0
    """Seed of all random numbers."""
    report: Path = Path("runs/faults.json")
    """File for the numbers."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import json
import logging
import tempfile
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from aslip.training.run import write_text
from aslip.walking import markdown
from benchmarks.faults.files import damaged, strangers
from benchmarks.faults.kinds import KINDS
from benchmarks.faults.runs import (
    checkpoint_cost,
    cuts,
    flips,
    full_disks,
    kills,
    losses,
    raises,
    settings,
    workers,
)
from benchmarks.faults.simulations import bad_numbers, steps

Inject = Callable[[int, np.random.Generator, Path], int]
"""Function that injects a number of faults, with a folder for files; returns the survived ones."""


def main(config: Config) -> dict[str, dict[str, int]]:
    """Inject all faults, print and write the table; returns it, by fault."""
    torch.set_num_threads(1)
    # MuJoCo warns of every simulation that diverges
    logging.getLogger("absl").setLevel(logging.ERROR)
    faults: dict[str, tuple[int, Inject]] = {
        "bad number in a simulation's state": (config.numbers, bad_numbers),
        "simulation raises in training": (config.raises, raises),
        "training killed": (config.kills, kills),
        "collector process killed": (config.workers, workers),
        "newest checkpoint truncated": (config.cuts, cuts),
        "bit of the newest checkpoint flipped": (config.flips, flips),
        "all checkpoints truncated": (config.losses, losses),
        "disk full": (config.full_disks, full_disks),
        "program in a file": (config.strangers, strangers),
        **{f"damaged {kind}": (config.files, partial(damaged, kind)) for kind in KINDS},
        "setting of wrong type or range": (config.settings, settings),
        "policy steps of random actions": (config.steps, steps),
    }
    table: dict[str, dict[str, int]] = {}
    numbers: dict[str, Any] = {"seed": config.seed, "faults": table}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for i, (name, (count, inject)) in enumerate(tqdm(faults.items(), unit="fault")):
            if count:
                rng = np.random.default_rng([config.seed, i])
                table[name] = {"injected": count, "survived": inject(count, rng, folder)}
        if config.robots:
            numbers["checkpoint"] = checkpoint_cost(folder, config.robots)
    rows = [[name, str(n["injected"]), str(n["survived"])] for name, n in table.items()]
    print(markdown(["fault", "injected", "survived"], rows))
    config.report.parent.mkdir(parents=True, exist_ok=True)
    write_text(config.report, json.dumps(numbers, indent=1) + "\n")
    return table


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
