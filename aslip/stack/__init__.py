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

from aslip.stack.edit import edited, insert_before, judged, randomised
from aslip.stack.environment import CassieTransformedEnv, check_seed
from aslip.stack.interface import (
    acts_on,
    baseline,
    check_fits,
    commanded,
    described,
    interface_of,
    observed,
)
from aslip.stack.make import Backend, make_env
from aslip.stack.stacks import (
    EPISODE_ENDS,
    MAX_EPISODE_STEPS,
    ON_TRUTH,
    STACKS,
    RewardSource,
    Stack,
    default_stack,
    paper_stack,
    reward_terms,
    single_reference_stack,
)

__all__ = [
    "EPISODE_ENDS",
    "MAX_EPISODE_STEPS",
    "ON_TRUTH",
    "STACKS",
    "Backend",
    "CassieTransformedEnv",
    "RewardSource",
    "Stack",
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
]
