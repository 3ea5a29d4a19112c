"""Stacks by name, and copies of stacks for evaluations and for real robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from aslip.envs.directions import directions_stack, planned_stack, walking_stack
from aslip.envs.edit import Stack, needs_simulation, require_names
from aslip.envs.straight import default_stack, paper_stack, shipped_library, single_reference_stack
from aslip.library import GaitLibrary
from aslip.transforms import ObservationNoise, ReferenceInjection, RewardTerm, TrueState
from aslip.transforms.rewards import DIRECTION_WEIGHTS, PAPER_WEIGHTS

EPISODE_ENDS: Final = ("low_reward", "step_limit")
"""Transforms that end episodes without a fall; drop them to evaluate a policy."""

ON_TRUTH: Final[Mapping[str, Any]] = MappingProxyType(
    {"drop": ("noise",), "replace": {"estimator": TrueState()}}
)
"""Arguments of `make_env` for policies that observe the true state instead of the estimate."""

STACKS: Final[Mapping[str, Callable[..., Stack]]] = {
    "straight": default_stack,
    "paper": paper_stack,
    "single_reference": single_reference_stack,
    "walking": walking_stack,
    "directions": directions_stack,
    "planned": planned_stack,
}
"""Name of a stack -> function of gait library and `reward_on` that makes it."""

_EVALUATION = (*PAPER_WEIGHTS, "reward", "fall", "low_reward", "step_limit", "episode_sum")
"""Transforms of the default stack that compute rewards or end episodes."""


def robot_stack(stack: Stack | None = None) -> Stack:
    """Copy of a stack for a real robot or a replayed log.

    Transforms that need a simulation (`needs_simulation`) are left out, and `ObservationNoise`, as
    real sensors have their own noise.

    Args:
        stack: `default_stack(reward_on="estimate")` by default.

    Raises:
        ConfigurationError: `stack` is a name.
    """
    stack = default_stack(reward_on="estimate") if stack is None else stack
    require_names(stack, [])
    return {
        name: transform
        for name, transform in stack.items()
        if not needs_simulation(transform) and not isinstance(transform, ObservationNoise)
    }


def evaluation_stack(stack: Stack, library: GaitLibrary | None = None) -> Stack:
    """Copy of a stack for evaluation, with the same task and rewards for every experiment.

    Observation and action baseline are those of the given stack, whose own reward terms are left
    out. Robot, start, rewards and ends of episodes are those of `default_stack(library)`, or in all
    directions of `walking_stack(library)`, whose commands are walked; the rewards compare with its
    gaits, even if the policy observes another motion. A stack that stands keeps standing.

    Args:
        stack: the stack.
        library: library of the gaits; by default the paper's.

    Raises:
        ConfigurationError: `stack` is a name, or commands of the library do not have three numbers.
        UnknownNameError: the stack has no transform `start`.
    """
    require_names(stack, ["start"])
    library = shipped_library("gaits") if library is None else library
    turning, names = library.command_size > 1, [*_EVALUATION]
    name = ("directions" if "stand" in stack else "walking") if turning else "straight"
    common = STACKS[name](library)
    if turning:
        names = [name for name in common if name in {*names, *DIRECTION_WEIGHTS}]
    evaluation = {name: common[name] for name in ("start", *names)}
    trained = {"difficulty", "dynamics", "encoders", "pushes", "privileged"}
    seen = {
        name: transform
        for name, transform in stack.items()
        if name not in trained | {*evaluation} and not isinstance(transform, RewardTerm)
    }
    compared: dict[str, Any] = {"out_keys": ("comparison", "target")}
    if turning:
        seen["command"] = common["command"]
        compared["in_keys"] = ["filtered_command", "phase"]
        compared["in_keys"] += ["mode", "stand"] if "stand" in stack else []
    target = ReferenceInjection(library, **compared)
    return {"start": evaluation.pop("start"), **seen, "comparison": target, **evaluation}
