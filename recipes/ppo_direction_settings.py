"""Settings of `ppo_directions.py`, without any import of PyTorch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ppo_settings import ON_GPU, Config

from aslip.training.settings import check_positive, check_range


@dataclass(frozen=True)
class DirectionConfig(Config):
    """Settings of learning, and of the robots to learn on."""

    out: Path = Path("runs/ppo_directions")
    """Folder of the run."""
    total_steps: int = 4_990_000
    """Policy steps to train for, rounded up to whole updates."""
    library: str = "directions"
    """Library over three commands: the shipped one, or a file from `direction_library.py`."""
    command_interval: float = 4.0
    """Mean time between changes of the command in an episode [s]."""
    command_rates: float = 2.0
    """Factor on the rates at which the followed command changes (`aslip.transforms.COMMAND_RATES`),
    in training only."""
    stand: float = 0.2
    """Share of the time with a stand command; 0 for robots that only walk. Others need a library
    with stop and start."""
    stand_interval: float = 6.0
    """Mean time between draws of the stand command in an episode [s]."""
    randomise: bool = True
    """Draw dynamics and sensor noise of each episode from `aslip.transforms.WIDE_RANGES`."""
    randomise_share: float = 0.3
    """Probability with which a parameter of dynamics and sensors is drawn; else it is nominal."""
    encoder_offset: float = 0.01
    """Largest offset of the motor encoders of robots that differ [rad]; 0 for none."""
    push_impulse: float = 30.0
    """Largest impulse of random pushes [N s]; 0 for none."""
    push_interval: float = 8.0
    """Mean time between pushes [s]."""
    ramp: float = 0.5
    """Share of the training over which ranges and pushes grow from nothing to their full size; 0
    for full size from the start."""
    privileged: bool = True
    """Show true state and dynamics to the critic."""

    def __post_init__(self) -> None:
        """Check types and ranges.

        Raises:
            ConfigurationError: a setting is invalid.
        """
        super().__post_init__()
        check_range(self, 0, 1, "stand", "ramp", "randomise_share")
        check_range(self, 0, math.inf, "push_impulse", "encoder_offset")
        check_positive(self, "command_rates", "command_interval", "stand_interval", "push_interval")


DIRECTION_PRESETS = {
    "default": DirectionConfig(),
    "gpu": DirectionConfig(
        preset="gpu", out=Path("runs/ppo_directions_gpu"), **ON_GPU, total_steps=25_000_000
    ),
}
"""Settings to start from, by name."""
