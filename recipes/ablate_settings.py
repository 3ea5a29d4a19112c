"""Settings of ablations, without any import of PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from aslip.base.assets import UserPaths
from aslip.base.imports import extras
from aslip.errors import ConfigurationError
from aslip.training.settings import LoggerName

with extras():
    import tyro


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of ablations.

    Raises:
        ConfigurationError: there is no seed.
    """

    task: tyro.conf.Suppress[tyro.conf.Fixed[str]] = "straight"
    """Name of the walks that are trained."""
    variants: tuple[str, ...] = ()
    """Names of the variants to train, all by default; or Python files, whose public functions are
    variants and edit the stack."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of each variant."""
    total_steps: int = 500_000
    """Policy steps of each training."""
    num_envs: int = 256
    """Robots simulated side by side."""
    out: Path = Path("runs/ablation")
    """Folder of all trainings, the table `ablation.md` and the picture `ablation.png`."""
    library: str = "gaits"
    """Library of gaits: a shipped one, or a file."""
    logger: LoggerName = "none"
    """Logger of each training, see `ppo_aslip.py`."""
    list: bool = False
    """List the variants and train nothing."""

    def __post_init__(self) -> None:
        """Check the seeds."""
        super().__post_init__()
        if not self.seeds:
            raise ConfigurationError("name at least one seed")


TASKS: Final[Mapping[str, Config]] = {
    "straight": Config(),
    "directions": Config(
        "directions", seeds=(0,), total_steps=1_200_000, out=Path("runs/direction_ablation"),
        library="directions",
    ),
}  # fmt: skip
"""Name of a task -> default settings."""

DESCRIPTIONS: Final = {
    "straight": "walks straight ahead, 21 speeds",
    "directions": "walks in all directions, 32 commands, on nominal and on drawn robots",
}
