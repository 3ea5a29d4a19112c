"""All faults, and the table of what was survived."""

from __future__ import annotations

import json
import logging
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from aslip.training.run import write_text
from aslip.walking import markdown
from benchmarks.faults.checkpoints import checkpoint_cost, cuts, flips, full_disks, losses
from benchmarks.faults.config import Config
from benchmarks.faults.files import damaged
from benchmarks.faults.kinds import KINDS
from benchmarks.faults.processes import kills, raises, workers
from benchmarks.faults.settings import settings
from benchmarks.faults.simulations import bad_numbers, steps
from benchmarks.faults.strangers import strangers

Inject = Callable[[int, np.random.Generator, Path], int]
"""Injects so many faults, with a folder for files; returns how many were survived."""


def main(config: Config) -> dict[str, dict[str, int]]:
    """Inject everything; print and write the table. Returns it, by fault."""
    torch.set_num_threads(1)
    # MuJoCo tells of every simulation that diverges
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
