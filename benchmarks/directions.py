"""Parts that benchmarks of walks in all directions share."""

from __future__ import annotations

from functools import partial

import numpy as np

import aslip
from aslip.envs import directions_stack
from aslip.library import GaitLibrary
from aslip.transforms import VelocityCommand
from benchmarks.common import MakeEnv, Policy, Subject, load_subjects
from benchmarks.flags import Common

__all__ = ["LIMITS", "direction_subjects", "random_commands"]

LIMITS = ("forward [m/s]", "sideways [m/s]", "yaw rate [rad/s]")
"""Names of a command's numbers, for tables and pictures."""


def direction_subjects(
    config: Common, path: str, policy: Policy | None, make_env: MakeEnv | None
) -> tuple[list[Subject], GaitLibrary]:
    """Subjects in environments of the library at a path, and the library."""
    library = GaitLibrary.load(path)
    make_env = make_env or partial(aslip.make_env, stack=directions_stack(library))
    return load_subjects(config, policy, make_env), library


def random_commands(library: GaitLibrary, count: int, seed: int) -> np.ndarray:
    """Commands (count, c), uniform over the region, without extra shares of special cases."""
    command = VelocityCommand(library, straight=0.0, turning=0.0, in_place=0.0)
    command.set_seed(seed)
    return command.draw((count, library.command_size)).double().numpy()
