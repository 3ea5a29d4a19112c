"""Teach Cassie to follow forward speed, sideways speed and yaw rate, and to stand.

    python recipes/ppo_directions.py                   # train, evaluate, draw: runs/ppo_directions/
    python recipes/ppo_directions.py --resume          # continue after Ctrl-C, kill or a crash
    python recipes/ppo_directions.py gpu               # 16384 robots on a GPU
    python recipes/ppo_directions.py --library runs/small/gaits.npz --no-randomise --push-impulse 0

PPO is that of `ppo_aslip.py`. In each episode some parameters of robot, floor and sensors are drawn
at random; pushes and stand commands come at random times; and the critic sees true state and
dynamics, which the policy does not. Training begins with nominal robots and without pushes, and
ranges and pushes grow from there. Evaluations walk commands from all over the region, on nominal
robots, without pushes, at 2 kHz physics.
"""

from __future__ import annotations

from ppo_direction_settings import DIRECTION_PRESETS, DirectionConfig
from ppo_settings import resume_command, training_settings, with_schedule

from aslip.errors import one_line_errors

if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = training_settings(DIRECTION_PRESETS)

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import ppo_aslip
from tensordict.utils import NestedKey

import aslip
from aslip.envs import Stack, directions_stack, insert_before, randomise_stack, walking_stack
from aslip.policy import make_critic, make_privileged_critic, privileged_table
from aslip.training.environments import make_training_env
from aslip.training.settings import read_settings
from aslip.transforms import (
    WIDE_RANGES,
    AssembleObservation,
    CommandFilter,
    Difficulty,
    EncoderOffsets,
    RandomDynamics,
    RandomPushes,
    StandCommand,
)
from aslip.walking import WalkResult

PRIVILEGED = "privileged"
"""Key of the entries that only the critic sees."""


def main(
    config: DirectionConfig,
    resume_hint: str = "resume=True",
    *,
    make_stack: Callable[[aslip.GaitLibrary], Stack] | None = None,
    add_training: Callable[[Stack], Stack] = lambda stack: stack,
    numbers: Sequence[NestedKey] = (),
    **networks: Any,
) -> list[WalkResult]:
    """Train a policy and evaluate it over the region of the library; see `ppo_aslip.main`.

    Args:
        config: the settings.
        resume_hint: command that resumes the training, for messages.
        make_stack: function that makes the policy's stack; by default `directions_stack`, or
            `walking_stack` for robots that never stand.
        add_training: function that adds more to the stack for training.
        numbers: keys of more entries for a privileged critic, see `aslip.policy.privileged_table`.
        networks: arguments of `ppo_aslip.main` for other networks, such as `make_actor`.
    """
    config = with_schedule(config, read_settings(config.out)[0] if config.resume else None)
    if make_stack is None:
        make_stack = directions_stack if config.stand else walking_stack
    stack = make_stack(aslip.GaitLibrary.load(config.library))
    robots = partial(aslip.make_env, stack=add_training(training_stack(config, stack, numbers)))
    critic = make_critic
    if config.privileged:
        known = {"dynamics": drawn(config), "numbers": numbers}
        critic = partial(make_privileged_critic, **known, key=PRIVILEGED)
    return ppo_aslip.main(
        config,
        partial(aslip.make_env, stack=stack),
        make_critic=critic,
        make_train_env=partial(make_training_env, robots, config.command_interval),
        resume_hint=resume_hint,
        **networks,
    )


def training_stack(
    config: DirectionConfig, stack: Stack, numbers: Sequence[NestedKey] = ()
) -> Stack:
    """Stack for training.

    It differs in rates of the command, and has stand commands, other robots, pushes and entries for
    the critic.
    """
    limits = cast("CommandFilter", stack["command_filter"].clone())
    limits.rates = tuple(config.command_rates * rate for rate in limits.rates)
    stack = {**stack, "command_filter": limits}
    if config.stand:
        stack["stand"] = StandCommand(config.stand, config.stand_interval)
    steps, share = config.schedule_steps or config.total_steps, config.randomise_share
    ramp = round(config.ramp * steps / config.num_envs)
    difficulty = "difficulty" if ramp else None
    disturbances: Stack = {}
    if ramp:  # after the dynamics, which read it
        disturbances["difficulty"] = Difficulty(ramp)
    if config.push_impulse:
        disturbances["pushes"] = RandomPushes(
            config.push_impulse, config.push_interval, difficulty_key=difficulty
        )
    stack = insert_before(stack, "command", **disturbances)
    if config.randomise:
        stack = randomise_stack(stack, WIDE_RANGES)
        stack["dynamics"] = RandomDynamics(WIDE_RANGES, share=share, difficulty_key=difficulty)
        offsets = EncoderOffsets(config.encoder_offset, share=share, difficulty_key=difficulty)
        stack = insert_before(stack, "estimator", encoders=offsets)
    if config.privileged:
        table = privileged_table(drawn(config), numbers)
        seen = AssembleObservation(table, out_keys=[PRIVILEGED])
        stack = insert_before(stack, "action", privileged=seen)
    return stack


def drawn(config: DirectionConfig) -> list[str]:
    """Names of the parameters that are drawn in training."""
    return [*WIDE_RANGES] if config.randomise else []


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, resume_hint=resume_command(CONFIG))
