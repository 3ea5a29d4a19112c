"""Environments to train in and to evaluate on."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from typing import Any, Final

from torchrl.envs.transforms import StepCounter

from aslip.envs import StackEnv, command_speeds, describe_transforms
from aslip.transforms import RandomCommand, StaggeredEnds, VelocityCommand
from aslip.transforms.base import check_interval

DIRECTIONS: Final = 32
"""Number of commands in all directions that an evaluation walks."""

MakeEnv = Callable[..., StackEnv]
"""Function of the keywords `num_envs` and `seed`, such as `aslip.make_env`; for robots in other
processes, also of `num_threads`."""


def make_training_env(
    make_env: MakeEnv, command_interval: float = 8.0, **settings: Any
) -> StackEnv:
    """Environment for training: first episodes of different lengths, and changing commands.

    Args:
        make_env: makes the environment.
        command_interval: mean time between changes of the commanded speed [s]; infinite for a
            constant speed per episode. A `RandomCommand` with a finite interval keeps its own.
        settings: keywords of `make_env`.

    Raises:
        ConfigurationError: `command_interval` is shorter than a policy step.
    """
    check_interval(command_interval)
    env = make_env(**settings)
    limits = [t.max_steps for t in env.transforms if isinstance(t, StepCounter)]
    if limits and limits[0] is not None:
        env.append_transform(StaggeredEnds(limits[0]))
    for transform in env.transforms:
        if isinstance(transform, RandomCommand) and math.isinf(transform.interval):
            transform.interval = command_interval
    return env


def make_evaluation_env(
    make_env: MakeEnv, seed: int
) -> tuple[StackEnv, list[float] | list[list[float]]]:
    """Environment with one robot for each command of an evaluation, and the commands.

    These are all speeds [m/s] of a `SpeedCommand`, or `DIRECTIONS` draws of a `VelocityCommand`,
    the same for each seed.

    Args:
        make_env: makes the environment.
        seed: seed of the environment.
    """
    with closing(make_env(num_envs=1, seed=seed)) as env:
        drawn = [t for t in env.transforms if isinstance(t, VelocityCommand)]
        commands = _directions(drawn[0]) if drawn else command_speeds(env)
    return make_env(num_envs=len(commands), seed=seed), commands


def _directions(command: VelocityCommand) -> list[list[float]]:
    command.set_seed(0)
    return command.draw((DIRECTIONS, command.library.command_size)).tolist()


def describe_environments(env: StackEnv, make_train_env: MakeEnv) -> dict[str, str]:
    """Description of each transform for evaluation, and for training if it differs.

    Args:
        env: environment for evaluation.
        make_train_env: makes the environment for training.
    """
    texts = describe_transforms(env)
    with closing(make_train_env(num_envs=1, seed=0)) as training:
        described = describe_transforms(training)
    differing = {name: text for name, text in described.items() if texts.get(name) != text}
    return texts | {f"training/{name}": text for name, text in differing.items()}
