"""The environment most people want: a backend and a stack of transforms.

An experiment is a stack that differs from the default one in a line or two:

    make_env(drop=["foot_orient"])                               # ablate a reward term
    make_env(replace={"reward": WeightedReward({...})})          # weigh the terms otherwise
    make_env(replace={"start": ReferenceStart(library, "rest")}) # start at rest
    make_env(replace={"estimator": TrueState()})                 # perfect knowledge of the state
    make_env(drop=["noise"])                                     # perfect sensors
    make_env(reward_on="estimate")                               # reward what the robot knows
    make_env(stack=insert_before(stack, "reward", my_term=...))  # one more term
    make_env(stack=randomised(default_stack()))                  # robots that differ
    make_env(stack="paper")                                      # the paper to the letter
    make_env(stack="single_reference")                           # what the paper compares with

A stack is an ordered dict of names and transforms. It is never edited in place once it belongs to
an environment, where TorchRL would keep stale specs; build another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from aslip.envs.base import CassieEnv
    from aslip.envs.batch import BatchCassieEnv
    from aslip.envs.choices import Backend, RewardSource
    from aslip.envs.dm_control import DmControlCassieEnv
    from aslip.envs.edit import edited, insert_before, judged, randomised
    from aslip.envs.environment import CassieTransformedEnv, check_seed
    from aslip.envs.interface import (
        acts_on,
        baseline,
        check_fits,
        commanded,
        described,
        interface_of,
        observed,
    )
    from aslip.envs.make import make_env
    from aslip.envs.physics import CassiePhysics
    from aslip.envs.stacks import (
        EPISODE_ENDS,
        MAX_EPISODE_STEPS,
        ON_TRUTH,
        STACKS,
        Stack,
        default_stack,
        paper_stack,
        reward_terms,
        single_reference_stack,
    )
    from aslip.envs.walk_task import Walk, walk_environment

__all__ = [
    "EPISODE_ENDS",
    "MAX_EPISODE_STEPS",
    "ON_TRUTH",
    "STACKS",
    "Backend",
    "BatchCassieEnv",
    "CassieEnv",
    "CassiePhysics",
    "CassieTransformedEnv",
    "DmControlCassieEnv",
    "RewardSource",
    "Stack",
    "Walk",
    "acts_on",
    "baseline",
    "check_fits",
    "check_seed",
    "commanded",
    "default_stack",
    "described",
    "edited",
    "insert_before",
    "interface_of",
    "judged",
    "make_env",
    "observed",
    "paper_stack",
    "randomised",
    "reward_terms",
    "single_reference_stack",
    "walk_environment",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "base": ["CassieEnv"],
        "batch": ["BatchCassieEnv"],
        "choices": ["Backend", "RewardSource"],
        "dm_control": ["DmControlCassieEnv"],
        "edit": ["edited", "insert_before", "judged", "randomised"],
        "environment": ["CassieTransformedEnv", "check_seed"],
        "interface": [
            "acts_on",
            "baseline",
            "check_fits",
            "commanded",
            "described",
            "interface_of",
            "observed",
        ],
        "make": ["make_env"],
        "physics": ["CassiePhysics"],
        "stacks": [
            "EPISODE_ENDS",
            "MAX_EPISODE_STEPS",
            "ON_TRUTH",
            "STACKS",
            "Stack",
            "default_stack",
            "paper_stack",
            "reward_terms",
            "single_reference_stack",
        ],
        "walk_task": ["Walk", "walk_environment"],
    },
)
