"""Flags that the benchmarks of a policy share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import ConfigurationError


@dataclass(frozen=True)
class Common:
    """Flags of every benchmark of a policy."""

    policy: tuple[str, ...] = ("aslip",)
    """Policies to measure: names, files or run folders; several count as seeds of one method."""
    truth: bool = False
    """Give the policy the true state instead of the state estimate."""
    seed: int = 0
    """Seed of the sensor noise."""
    out: Path = Path("runs/benchmarks")
    """Folder for the table, results and picture."""

    def __post_init__(self) -> None:
        """Check that there is a policy."""
        if not self.policy:
            raise ConfigurationError("name at least one policy")


@dataclass(frozen=True)
class Compared(Common):
    """Flags of benchmarks that compare policies with the paper's settings and its baseline."""

    paper: tuple[str, ...] = ()
    """Policies of `ppo_aslip.py paper`."""
    baseline: tuple[str, ...] = ()
    """Policies of `ppo_aslip.py single-reference`."""

    def __post_init__(self) -> None:
        """Check that there is a policy of any kind."""
        if not (self.policy or self.paper or self.baseline):
            raise ConfigurationError("name at least one policy")


@dataclass(frozen=True)
class Directions(Common):
    """Flags of benchmarks of walks in all directions."""

    policy: tuple[str, ...] = ("runs/ppo_directions",)
    """Policies to measure: files or run folders; several count as seeds of one method."""
    library: str = "runs/directions/gaits.npz"
    """Library over three commands that the policies were trained with."""
