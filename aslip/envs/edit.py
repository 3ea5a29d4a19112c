"""Stacks made of stacks: more, fewer, or other transforms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial

from torchrl.envs.transforms import Transform

from aslip.envs.stacks import Stack, default_stack
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.transforms import RandomDynamics, RandomNoise, ReferenceInjection
from aslip.transforms.rewards import PAPER_WEIGHTS

_JUDGES = (*PAPER_WEIGHTS, "reward", "fall", "low_reward", "step_limit", "episode_sum")
"""Transforms of the default stack that judge what a robot does."""


def randomised(stack: Stack) -> Stack:
    """A copy of a stack whose robots differ from episode to episode.

    Dynamics and, if there is sensor noise, its levels are drawn from
    `aslip.transforms.DYNAMICS_RANGES` at each reset.

    Raises:
        ConfigurationError: the stack is only the name of one, or randomised already.
        UnknownNameError: it has no transform `start`.
    """
    stack = insert_before(stack, "start", dynamics=RandomDynamics)
    return {name: RandomNoise if name == "noise" else make for name, make in stack.items()}


def judged(stack: Stack) -> Stack:
    """A copy of a stack on which policies of different experiments are judged alike.

    What a policy observes and what its action is added to stay the stack's own. The robot, where it
    starts, rewards and ends of episodes are those of `default_stack()`; its gaits are the goal of
    the rewards, also where the policy sees another model's motion.

    Raises:
        ConfigurationError: the stack is only the name of one.
        UnknownNameError: it has no transform `start`.
    """
    _require_names(stack, ["start"])
    common = default_stack()
    judges = {name: common[name] for name in ("start", *_JUDGES)}
    seen = {name: make for name, make in stack.items() if name not in {"dynamics", *judges}}
    goal = partial(ReferenceInjection, GaitLibrary.load(), reference_key="judge")
    return {"start": judges.pop("start"), **seen, "judge": goal, **judges}


def insert_before(stack: Stack, name: str, **new: Callable[[], Transform]) -> Stack:
    """A copy of a stack with more transforms, in front of the named one.

    Raises:
        ConfigurationError: the stack is only the name of one, or has a new transform's name.
        UnknownNameError: the stack has no transform of that name.
    """
    _require_names(stack, [name])
    if taken := sorted(new.keys() & stack.keys()):
        raise ConfigurationError(f"the stack has {taken} already; assign, or take other names")
    longer: Stack = {}
    for key, make in stack.items():
        if key == name:
            longer |= new
        longer[key] = make
    return longer


def edited(
    stack: Stack,
    drop: Iterable[str],
    replace: Mapping[str, Transform | Callable[[], Transform]],
) -> dict[str, Transform | Callable[[], Transform]]:
    """A copy of a stack without some transforms, and with something else for others.

    Raises:
        UnknownNameError: the stack has no transform of such a name.
    """
    drop = [drop] if isinstance(drop, str) else list(drop)
    _require_names(stack, [*drop, *replace])
    return {name: replace.get(name, make) for name, make in stack.items() if name not in drop}


def _require_names(stack: Stack, names: Iterable[str]) -> None:
    """Check that a stack has transforms of these names.

    Raises:
        ConfigurationError: it is the name of a stack.
        UnknownNameError: it lacks one; the message has the nearest name and all others.
    """
    if isinstance(stack, str):
        raise ConfigurationError(
            f"{stack!r} is the name of a stack, give the stack itself, such as default_stack()"
        )
    for name in names:
        if name not in stack:
            raise UnknownNameError.among("transform", name, stack)
