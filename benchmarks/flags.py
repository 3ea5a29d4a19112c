"""Flags that the benchmarks of a policy share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import ConfigurationError


@dataclass(frozen=True)
class Common:
    """Flags of every benchmark of a policy."""

    policy: tuple[str, ...] = ("aslip",)
    """Policies to measure, as `aslip.load_policy` takes them; several count as seeds of one."""
    truth: bool = False
    """Show them the simulator's truth instead of what an estimator makes of noisy sensors."""
    seed: int = 0
    """Seed of the sensor noise."""
    out: Path = Path("runs/benchmarks")
    """Folder of table, numbers and picture."""

    def __post_init__(self) -> None:
        """Check the settings."""
        if not self.policy:
            raise ConfigurationError("name at least one policy")
