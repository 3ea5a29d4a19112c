"""Flags that the benchmarks of a policy share, and checks of their numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aslip.base.assets import UserPaths
from aslip.errors import ConfigurationError


@dataclass(frozen=True)
class Common(UserPaths):
    """Flags of every benchmark of a policy."""

    policy: tuple[str, ...] = ("straight",)
    """Policies to measure: names, files or run folders; several count as seeds of one method."""
    truth: bool = False
    """Give the policy the true state instead of the state estimate."""
    seed: int = 0
    """Seed of the sensor noise."""
    out: Path = Path("runs/benchmarks")
    """Folder for the table, results and picture."""

    def __post_init__(self) -> None:
        """Check that there is a policy."""
        super().__post_init__()
        if not self.policy:
            raise ConfigurationError("name at least one policy")


@dataclass(frozen=True)
class WithLibrary(Common):
    """Flags of benchmarks of policies that may walk in all directions."""

    library: str | None = None
    """Library that the policies were trained with: a file, or a shipped one; by default the copy
    beside each policy, or that of its stack."""


@dataclass(frozen=True)
class Directions(WithLibrary):
    """Flags of benchmarks of walks in all directions."""

    policy: tuple[str, ...] = ("directions",)
    """Policies to measure: names, files or run folders; several count as seeds of one method."""


def check_numbers(config: Any, *positive: str, **least: float) -> None:
    """Check settings: some must be positive and finite, others at least as large as given.

    Raises:
        ConfigurationError: one is not.
    """
    for name in positive:
        if not 0 < getattr(config, name) < math.inf:
            raise ConfigurationError(f"{name} must be positive, got {getattr(config, name)}")
    for name, low in least.items():
        if not getattr(config, name) >= low:
            raise ConfigurationError(f"{name} must be {low} or more, got {getattr(config, name)}")
