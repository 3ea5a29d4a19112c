"""Interface between environment and policy: entries of the observation, baseline of the action."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from tensordict.utils import NestedKey, unravel_key
from torch import nn
from torchrl.envs.transforms import Transform

from aslip.base.decorators import on_cpu_in_single
from aslip.envs.describe import observation_keys
from aslip.envs.keep import KeepKeys
from aslip.envs.stack_env import StackEnv
from aslip.envs.stacks import STACKS
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import check_policy_library, entry_names, observation_difference, read_card
from aslip.transforms import (
    ActionDelta,
    AssembleObservation,
    CommandFilter,
    PhaseClock,
    PlannedReference,
    ReferenceInjection,
    StandClock,
)
from aslip.transforms.observation import planned_table


@on_cpu_in_single
def policy_interface(env: StackEnv) -> dict[str, Any]:
    """Interface of an environment to a policy, as arguments of `aslip.policy.save_policy`.

    Raises:
        ConfigurationError: no `AssembleObservation` makes an observation.
    """
    library = reference_library(env)
    return {
        "stack": stack_name(env),
        "observation": observation_keys(env),
        "baseline": baseline_key(env),
        "command_rates": command_rates(env),
        "stands": stands(env),
        "library_sha256": None if library is None else library.sha256,
    }


def reference_library(env: StackEnv) -> GaitLibrary | None:
    """Gaits of an environment's reference, also with a planner; None for another reference."""
    kinds = ReferenceInjection | PlannedReference
    found = (t.library for t in env.transforms if isinstance(t, kinds))
    return cast("GaitLibrary | None", next(found, None))


def stack_name(env: StackEnv) -> str | None:
    """Name of the stack in `STACKS` with the same interface to a policy, or None.

    Stacks differ if the entries of the observation, their order or the baseline of the action
    differ, or if the reference is no gait library, or another one than the clock's. Which gaits it
    has, rewards, ends of episodes, robots, sensors and other entries do not matter.
    """
    keys = _observation_keys(env.transforms), baseline_key(env)
    library = reference_library(env)
    clocks = [t.library for t in env.transforms if isinstance(t, PhaseClock | StandClock)]
    if None in keys or library is None or [c.sha256 for c in clocks] != [library.sha256]:
        return None
    turning = library.command_size == 3
    possible = ["straight", "paper", "single_reference"]
    if turning:
        possible = ["planned" if plans(env) else "directions" if stands(env) else "walking"]
    for name in possible:
        stack = STACKS[name](library if turning else None)
        if keys == (_observation_keys([stack["observation"]]), _baseline_key(stack["action"])):
            return name
    return None


def baseline_key(env: StackEnv) -> NestedKey | None:
    """Key of the action's baseline, the angles to which the action is added.

    None without an `ActionDelta`, or if another transform also changes actions.
    """
    acting = [t for t in env.transforms if _changes_actions(t)]
    return _baseline_key(acting[0]) if len(acting) == 1 else None


def command_rates(env: StackEnv) -> tuple[float, ...] | None:
    """Largest rates of the command that the policy follows; None without a `CommandFilter`."""
    rates = [t.rates for t in env.transforms if isinstance(t, CommandFilter)]
    return rates[0] if rates else None


def stands(env: StackEnv) -> bool:
    """True for a stack whose robots can stand, see `aslip.transforms.StandClock`."""
    return any(isinstance(t, StandClock) for t in env.transforms)


def plans(env: StackEnv) -> bool:
    """True for a stack in which a planner decides where and when the feet land."""
    return any(isinstance(t, PlannedReference) for t in env.transforms)


@on_cpu_in_single
def check_policy_fits(
    policy: str | Path | nn.Module, env: StackEnv, *, begins: bool = False
) -> None:
    """Check that an environment has the observation and action that a policy was trained with.

    Args:
        policy: name or path, as `aslip.load_policy` takes it. Of a module, only the size of the
            observation is checked, and only if `load_policy` made it.
        env: environment.
        begins: whether the policy's observation may be but the beginning of the environment's.

    Raises:
        AssetError: the policy does not exist.
        FileDamagedError: the file is truncated, altered or not a policy.
        ConfigurationError: the entries of the observation, their order, its size, the baseline of
            the action, the rates of the command or the gaits differ.
    """
    named = isinstance(policy, str | Path)
    card = {**read_card(policy), "name": str(policy)} if named else getattr(policy, "card", None)
    if card is None:
        return
    if why := _misfit(card, env, only_size=not named, begins=begins):
        raise ConfigurationError(
            f"the policy {card['name']!r} does not fit the environment: {why}; it was trained on"
            f" the stack {card['stack']!r}, and the environment has the stack {stack_name(env)!r}"
        )
    if named and (library := reference_library(env)) is not None:
        check_policy_library(card["name"], card, library)


def _misfit(card: Mapping[str, Any], env: StackEnv, *, only_size: bool, begins: bool) -> str:
    """First difference between an environment and that of a policy's card; empty for none."""
    shown = entry_names(observation_keys(env))
    if plans(env):
        # policies that have never seen a plan follow its command as they do their own
        card = {**card, "observation": entry_names(planned_table(card["observation"]))}
    if begins:
        shown = shown[: len(card["observation"])]
    if not only_size and card["observation"] != shown:
        return observation_difference(card["observation"], shown)
    has, size = card["shape"].observation_size, env.observation_spec["observation"].shape[-1]
    if has != size and not begins:
        return f"its observation has {has} numbers, the environment's has {size}"
    if only_size:
        return ""
    key = baseline_key(env)
    added_to = None if key is None else entry_names([key])[0]
    if card["baseline"] != added_to:
        return (
            f"its action must be added to {card['baseline']!r}, but the environment adds it to"
            f" {added_to!r}"
        )
    if card["command_rates"] != (rates := command_rates(env)):
        return (
            f"its commands change at most at the rates {card['command_rates']}, those of the"
            f" environment at {rates}"
        )
    return ""


def _observation_keys(transforms: Sequence[Transform]) -> tuple[NestedKey, ...] | None:
    """Keys of the observation's entries; None unless one `AssembleObservation` alone writes it."""
    writing = [t for t in transforms if "observation" in t.out_keys]
    if len(writing) != 1 or not isinstance(writing[0], AssembleObservation):
        return None
    return tuple(writing[0].in_keys)


def _changes_actions(transform: Transform) -> bool:
    """True if a transform changes actions between policy and robot."""
    keys = {*map(str, transform.in_keys_inv), *map(str, transform.out_keys_inv)}
    if keys & {"action", "motor_target"}:
        return True
    if isinstance(transform, KeepKeys):
        return False
    # transforms of TorchRL name the keys that they change, others may not
    owner = next(kind for kind in type(transform).__mro__ if "_inv_call" in vars(kind))
    return not owner.__module__.startswith("torchrl.")


def _baseline_key(transform: Transform) -> NestedKey | None:
    return unravel_key(transform.baseline_key) if isinstance(transform, ActionDelta) else None
