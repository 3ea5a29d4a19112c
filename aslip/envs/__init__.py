"""Environments: robots, simulators, and named stacks of transforms around them.

An experiment changes the default stack in a line or two:

    make_env(drop=["foot_orient"])                               # ablate a reward term
    make_env(replace={"reward": WeightedReward({...})})          # other weights of the terms
    make_env(replace={"start": ReferenceStart(library, "rest")}) # start at rest
    make_env(replace={"estimator": TrueState()})                 # true state, no estimator
    make_env(drop=["noise"])                                     # perfect sensors
    make_env(reward_on="estimate")                               # reward the estimated state
    make_env(stack=insert_before(stack, "reward", my_term=...))  # one more term
    make_env(stack=randomise_stack(default_stack()))             # domain randomisation
    make_env(stack="paper")                                      # the paper's own settings
    make_env(stack="single_reference")                           # the paper's baseline
    make_env(stack="standing")                                   # all directions, and standing

A stack is an ordered dict, name -> transform, of which each environment gets copies. The transforms
of an environment are never edited in place, as TorchRL would keep stale specs: edit the stack, and
make another environment.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from aslip.imports import attach

if TYPE_CHECKING:
    from aslip.envs.batch import BatchEnv
    from aslip.envs.directions import directions_stack, standing_stack
    from aslip.envs.dm_control import DmControlEnv, Walk, walk_environment
    from aslip.envs.edit import Stack, edit_stack, insert_before, randomise_stack
    from aslip.envs.gymnasium import GymEnv, GymVectorEnv
    from aslip.envs.interface import (
        baseline_key,
        check_policy_fits,
        command_speeds,
        describe_transforms,
        library_of,
        observation_keys,
        policy_interface,
        stack_name,
    )
    from aslip.envs.keep import KeepKeys
    from aslip.envs.make import make_env
    from aslip.envs.physics import BipedPhysics
    from aslip.envs.robot_env import RobotEnv
    from aslip.envs.simulated_env import SimulatedEnv
    from aslip.envs.stack_env import StackEnv, check_seed
    from aslip.envs.stacks import (
        EPISODE_ENDS,
        ON_TRUTH,
        STACKS,
        evaluation_stack,
        robot_stack,
    )
    from aslip.envs.straight import (
        MAX_EPISODE_STEPS,
        default_stack,
        paper_stack,
        reward_terms,
        shipped_library,
        single_reference_stack,
    )

Backend = Literal["batch", "dm_control"]
"""Simulators."""

RewardSource = Literal["truth", "estimate"]
"""Sources of the state that rewards read."""

__all__ = [
    "EPISODE_ENDS",
    "MAX_EPISODE_STEPS",
    "ON_TRUTH",
    "STACKS",
    "Backend",
    "BatchEnv",
    "BipedPhysics",
    "DmControlEnv",
    "GymEnv",
    "GymVectorEnv",
    "KeepKeys",
    "RewardSource",
    "RobotEnv",
    "SimulatedEnv",
    "Stack",
    "StackEnv",
    "Walk",
    "baseline_key",
    "check_policy_fits",
    "check_seed",
    "command_speeds",
    "default_stack",
    "describe_transforms",
    "directions_stack",
    "edit_stack",
    "evaluation_stack",
    "insert_before",
    "library_of",
    "make_env",
    "observation_keys",
    "paper_stack",
    "policy_interface",
    "randomise_stack",
    "reward_terms",
    "robot_stack",
    "shipped_library",
    "single_reference_stack",
    "stack_name",
    "standing_stack",
    "walk_environment",
]

__getattr__, __dir__ = attach(
    __name__,
    {
        "batch": ["BatchEnv"],
        "directions": ["directions_stack", "standing_stack"],
        "dm_control": ["DmControlEnv", "Walk", "walk_environment"],
        "edit": ["Stack", "edit_stack", "insert_before", "randomise_stack"],
        "gymnasium": ["GymEnv", "GymVectorEnv"],
        "interface": [
            "baseline_key",
            "check_policy_fits",
            "command_speeds",
            "describe_transforms",
            "library_of",
            "observation_keys",
            "policy_interface",
            "stack_name",
        ],
        "keep": ["KeepKeys"],
        "make": ["make_env"],
        "physics": ["BipedPhysics"],
        "robot_env": ["RobotEnv"],
        "simulated_env": ["SimulatedEnv"],
        "stack_env": ["StackEnv", "check_seed"],
        "stacks": [
            "EPISODE_ENDS",
            "ON_TRUTH",
            "STACKS",
            "evaluation_stack",
            "robot_stack",
        ],
        "straight": [
            "MAX_EPISODE_STEPS",
            "default_stack",
            "paper_stack",
            "reward_terms",
            "shipped_library",
            "single_reference_stack",
        ],
    },
)
