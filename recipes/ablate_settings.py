"""Settings that the recipes of ablations share, without any import of PyTorch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from aslip.base.assets import UserPaths
from aslip.errors import ConfigurationError, UnknownNameError


@dataclass(frozen=True)
class AblationConfig(UserPaths):
    """Settings of ablations.

    Raises:
        UnknownNameError: a variant is unknown.
        ConfigurationError: there is no variant or no seed.
    """

    names: ClassVar[tuple[str, ...]] = ()
    """Names of the variants that exist."""
    variants: tuple[str, ...] = ()
    """Names of the variants to train."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of each variant."""
    total_steps: int = 500_000
    """Policy steps of each training."""
    num_envs: int = 256
    """Robots simulated side by side."""
    out: Path = Path("runs/ablation")
    """Folder of all trainings, the table `ablation.md` and the picture `ablation.png`."""
    list: bool = False
    """List the variants and train nothing."""

    def __post_init__(self) -> None:
        """Check variants and seeds."""
        super().__post_init__()
        for name in self.variants:
            if name not in self.names:
                raise UnknownNameError.among("variant", name, self.names)
        if not self.variants or not self.seeds:
            raise ConfigurationError("name at least one variant and one seed")
