"""The policy: its networks, and its file."""

from aslip.policy.file import (
    CARD,
    POLICY_FILE,
    POLICY_FORMAT,
    find_policy,
    load_policy,
    observation_difference,
    policy_stack,
    read_card,
    save_policy,
)
from aslip.policy.networks import (
    PolicyShape,
    RunningNormalizer,
    entry_names,
    make_actor,
    make_critic,
    set_std,
)

__all__ = [
    "CARD",
    "POLICY_FILE",
    "POLICY_FORMAT",
    "PolicyShape",
    "RunningNormalizer",
    "entry_names",
    "find_policy",
    "load_policy",
    "make_actor",
    "make_critic",
    "observation_difference",
    "policy_stack",
    "read_card",
    "save_policy",
    "set_std",
]
