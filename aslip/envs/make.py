"""A backend and a stack put together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import get_args

from torchrl.envs.transforms import Transform

from aslip.envs import Backend, BatchEnv, DmControlEnv, RewardSource, SimulatedEnv
from aslip.envs.stack_env import StackEnv, check_seed, check_wiring
from aslip.envs.stacks import STACKS, Stack, edit_stack
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.robot.model import DEFAULT_FLOOR_FRICTION


def make_env(
    backend: Backend = "batch",
    *,
    num_envs: int = 1,
    seed: int = 0,
    drop: Iterable[str] = (),
    replace: Mapping[str, Transform | Callable[[], Transform]] | None = None,
    stack: Stack | str = "aslip",
    reward_on: RewardSource = "truth",
    library: GaitLibrary | None = None,
    num_threads: int = 0,
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    timestep: float = CASSIE.physics_timestep,
) -> StackEnv:
    """A TorchRL environment of n Cassies with the full stack of transforms.

    Losses that need the action's range take `env.action_spec_unbatched`, that of one robot. Given
    `env.action_spec`, which is of all n, `SACLoss` aims at n times the entropy.

    Args:
        backend: "batch" for training, "dm_control" for the reference task; same keys, same states.
        num_envs: number of robots n, at most 65,536, or 1,024 of the "dm_control" backend; all
            tensors have it as their first dimension.
        seed: reaches every random number, also inside transforms.
        drop: names of transforms to leave out. Without some reward terms the largest reward is
            smaller, while an episode still ends below 0.3: consider `LowReward` along with them.
        replace: name -> transform, or something that makes it, to take the place of another.
        stack: another stack altogether, or the name of one in `STACKS`.
        reward_on: what the rewards of a stack given by name read, "truth" or "estimate".
        library: gaits of a stack given by name; its own by default.
        num_threads: physics threads of the batch backend, 0 for all processors.
        floor_friction: sliding friction of the floor.
        timestep: of the batch backend's physics [s]: 0.0005, or 0.001 to train in half the time.

    Raises:
        ConfigurationError: unknown backend, a timestep that it cannot have, a number of
            environments or a seed that is none, a transform of another environment, settings of a
            named stack for one that is not, or transforms in an order in which one has no effect.
        UnknownNameError: there is no stack of that name, `drop` or `replace` names no transform of
            the stack, or a transform reads what no other writes.
    """
    if backend not in get_args(Backend):
        raise ConfigurationError(f"backend must be one of {get_args(Backend)}, got {backend!r}")
    if reward_on not in get_args(RewardSource):
        raise ConfigurationError(
            f"reward_on must be one of {get_args(RewardSource)}, got {reward_on!r}"
        )
    seed = check_seed(seed)
    if isinstance(stack, str):
        if stack not in STACKS:
            raise UnknownNameError.among("stack", stack, sorted(STACKS))
        stack = STACKS[stack](library, reward_on)
    elif library is not None or reward_on != "truth":
        raise ConfigurationError(
            "library and reward_on are for a stack that is given by name; give them to what makes"
            " the stack, such as default_stack(library, reward_on)"
        )
    chosen = edit_stack(stack, drop, replace or {})
    base: SimulatedEnv
    if backend == "batch":
        base = BatchEnv(
            num_envs, num_threads=num_threads, floor_friction=floor_friction, timestep=timestep
        )
    else:
        if timestep != CASSIE.physics_timestep:
            raise ConfigurationError(
                f"the dm_control backend has a timestep of {CASSIE.physics_timestep} s,"
                f" got {timestep!r}"
            )
        base = DmControlEnv(num_envs, floor_friction=floor_friction)
    stack_of = {name: t if isinstance(t, Transform) else t() for name, t in chosen.items()}
    for name, transform in stack_of.items():
        if transform.container is not None:
            raise ConfigurationError(
                f"the transform {name!r} belongs to another environment; for several, give what"
                f" makes one: a class, or lambda: {type(transform).__name__}(...)"
            )
    env = StackEnv(base, stack_of)
    check_wiring(env)
    env.set_seed(seed)
    return env
