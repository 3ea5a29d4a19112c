"""Settings of the fault benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Config:
    """Number of each fault; 0 skips it."""

    numbers: int = 600
    """NaN, infinities and huge values in one simulation's state."""
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
    """Runs all of whose checkpoints are truncated."""
    full_disks: int = 50
    """Disks that are full after a random number of bytes of a checkpoint."""
    strangers: int = 24
    """Files with a program inside, hidden in eight ways."""
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
