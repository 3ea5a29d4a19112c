"""Command line of the fault injection, see `benchmarks.faults`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import one_line_errors
from aslip.files.assets import UserPaths
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config(UserPaths):
    """Number of faults of each kind; 0 skips a kind."""

    bad_numbers: int = 600
    """Robots with NaN, infinity or a huge value in their state."""
    simulation_errors: int = 10
    """Trainings stopped by an exception in the simulation."""
    kills: int = 20
    """Trainings killed at a random moment."""
    worker_kills: int = 2
    """Collector processes killed."""
    truncations: int = 100
    """Newest checkpoints truncated at a random offset."""
    bit_flips: int = 100
    """Newest checkpoints with a flipped bit."""
    lost_checkpoints: int = 10
    """Runs with all checkpoints truncated."""
    full_disks: int = 50
    """Checkpoints whose disk is full after a random number of bytes."""
    hidden_programs: int = 24
    """Files with a hidden program, hidden in eight ways."""
    damaged_files: int = 1000
    """Damaged files of each kind."""
    bad_settings: int = 1000
    """Settings of a wrong type or out of range."""
    random_steps: int = 1_000_000
    """Policy steps with random actions."""
    timed_robots: int = 256
    """Number of robots of a training whose checkpoint is timed; 0 skips it."""
    seed: int = 0
    """Seed of all random numbers."""
    report: Path = Path("runs/faults.json")
    """JSON file for the results."""


if __name__ == "__main__":
    # parsed before the slow imports below
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
from benchmarks.faults.files import damaged_files, hidden_programs
from benchmarks.faults.kinds import KINDS
from benchmarks.faults.runs import (
    bad_settings,
    bit_flips,
    checkpoint_cost,
    full_disks,
    kills,
    lost_checkpoints,
    simulation_errors,
    truncations,
    worker_kills,
)
from benchmarks.faults.simulations import bad_numbers, random_steps

Inject = Callable[[int, np.random.Generator, Path], int]
"""Fault injector: (number of faults, generator, scratch folder) -> number survived."""


def main(config: Config) -> dict[str, dict[str, int]]:
    """Inject all faults, print the table and write it; returns it, by fault."""
    torch.set_num_threads(1)
    # silence MuJoCo's warning about each diverged simulation
    logging.getLogger("absl").setLevel(logging.ERROR)
    faults: dict[str, tuple[int, Inject]] = {
        "NaN, infinity or huge value in a simulation's state": (config.bad_numbers, bad_numbers),
        "exception in a training's simulation": (config.simulation_errors, simulation_errors),
        "training killed": (config.kills, kills),
        "collector process killed": (config.worker_kills, worker_kills),
        "newest checkpoint truncated": (config.truncations, truncations),
        "bit of the newest checkpoint flipped": (config.bit_flips, bit_flips),
        "all checkpoints truncated": (config.lost_checkpoints, lost_checkpoints),
        "disk full": (config.full_disks, full_disks),
        "hidden program in a file": (config.hidden_programs, hidden_programs),
        **{
            f"damaged {kind} file": (config.damaged_files, partial(damaged_files, kind))
            for kind in KINDS
        },
        "setting of a wrong type or out of range": (config.bad_settings, bad_settings),
        "policy step with random actions": (config.random_steps, random_steps),
    }
    table: dict[str, dict[str, int]] = {}
    numbers: dict[str, Any] = {"seed": config.seed, "faults": table}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for i, (name, (count, inject)) in enumerate(tqdm(faults.items(), unit="fault")):
            if count:
                rng = np.random.default_rng([config.seed, i])
                table[name] = {"injected": count, "survived": inject(count, rng, folder)}
        if config.timed_robots:
            numbers["checkpoint"] = checkpoint_cost(folder, config.timed_robots)
    rows = [[name, str(n["injected"]), str(n["survived"])] for name, n in table.items()]
    print(markdown(["fault", "injected", "survived"], rows))
    config.report.parent.mkdir(parents=True, exist_ok=True)
    write_text(config.report, json.dumps(numbers, indent=1) + "\n")
    return table


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
