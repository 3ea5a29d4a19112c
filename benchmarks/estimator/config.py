"""What is measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Config:
    """What to measure."""

    policy: str = "aslip"
    """Who walks, as `aslip.load_policy` names it."""
    steps: int = 400
    """Policy steps of a walk."""
    repeats: int = 4
    """Robots on each walk; they differ in the noise of their sensors."""
    falls: int = 64
    """Robots that fall and are reset."""
    num_envs: int = 256
    """Robots for the cost in throughput."""
    rounds: int = 15
    """Rounds to take the median of times over."""
    seed: int = 0
    """Of the noise."""
    out: Path = Path("runs/benchmarks")
    """Folder of tables, numbers and the picture of the walk through changes of speed."""
