"""Policies: networks, normaliser, symmetry and files."""

from aslip.policy.file import (
    CARD,
    POLICY_FILE,
    POLICY_FORMAT,
    MakeActor,
    check_policy_library,
    find_policy,
    load_policy,
    observation_difference,
    policy_library,
    policy_stack,
    read_card,
    save_policy,
)
from aslip.policy.networks import (
    PolicyShape,
    RunningNormalizer,
    action_layers,
    action_scale,
    entry_names,
    gaussian_actor,
    make_actor,
    make_critic,
    set_std,
    update_normalizers,
)
from aslip.policy.privileged import make_privileged_critic, privileged_table
from aslip.policy.recurrent import add_memory, forget, is_recurrent, make_recurrent_actor
from aslip.policy.symmetry import action_mirror, observation_mirror

__all__ = [
    "CARD",
    "POLICY_FILE",
    "POLICY_FORMAT",
    "MakeActor",
    "PolicyShape",
    "RunningNormalizer",
    "action_layers",
    "action_mirror",
    "action_scale",
    "add_memory",
    "check_policy_library",
    "entry_names",
    "find_policy",
    "forget",
    "gaussian_actor",
    "is_recurrent",
    "load_policy",
    "make_actor",
    "make_critic",
    "make_privileged_critic",
    "make_recurrent_actor",
    "observation_difference",
    "observation_mirror",
    "policy_library",
    "policy_stack",
    "privileged_table",
    "read_card",
    "save_policy",
    "set_std",
    "update_normalizers",
]
