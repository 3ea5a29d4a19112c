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
    make_env(stack="directions")                                 # all directions, and standing

A stack is an ordered dict, name -> transform, of which each environment gets copies. The transforms
of an environment are never edited in place, as TorchRL would keep stale specs: edit the stack, and
make another environment.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
