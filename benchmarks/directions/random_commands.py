"""Random commands in all directions, for benchmarks."""

from __future__ import annotations

import numpy as np

from aslip.library import GaitLibrary
from aslip.transforms import VelocityCommand

AXES = ("forward [m/s]", "sideways [m/s]", "yaw rate [rad/s]")
"""Names of a command's numbers, for tables and pictures."""


def random_commands(library: GaitLibrary, count: int, seed: int) -> np.ndarray:
    """Commands (count, c), uniform over the region, without extra shares of special cases."""
    command = VelocityCommand(library, straight=0.0, turning=0.0, in_place=0.0)
    command.set_seed(seed)
    return command.draw((count, library.command_size)).double().numpy()
