"""`make_env`: a simulator, or another robot, with a stack of transforms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import copy
from inspect import signature
from typing import Any, get_args

from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torch.nn.parameter import is_lazy
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform

from aslip.base.decorators import check_types, on_cpu_in_single
from aslip.envs import Backend, BatchEnv, RewardSource, RobotEnv, SimulatedEnv
from aslip.envs.edit import Stack, edit_stack
from aslip.envs.keep import KeepKeys
from aslip.envs.stack_env import StackEnv, check_seed, check_wiring, random_seed
from aslip.envs.stacks import STACKS
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.robot.model import DEFAULT_FLOOR_FRICTION


@check_types
@on_cpu_in_single
def make_env(
    backend: Backend = "batch",
    *,
    num_envs: int = 1,
    seed: int | None = None,
    drop: Iterable[str] = (),
    replace: Mapping[str, Transform] | None = None,
    stack: Mapping[str, Transform] | str = "straight",
    reward_on: RewardSource = "truth",
    library: GaitLibrary | None = None,
    keep: Iterable[NestedKey] | None = None,
    base: RobotEnv | Callable[..., RobotEnv] | None = None,
    num_threads: int = 0,
    device: str = "cuda",
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    timestep: float = CASSIE.physics_timestep,
) -> StackEnv:
    """Make a TorchRL environment of n robots with a stack of transforms.

    Pass `env.action_spec_unbatched`, the spec of one robot, to losses. With `env.action_spec`, the
    spec of all n robots, the target entropy of `SACLoss` is n times too large.

    Args:
        backend: simulator: "batch" for training, "warp" for training on a GPU, in single precision,
            or "dm_control" as the reference. Keys and states are the same.
        num_envs: number of robots n, at most 65,536, or 1,024 with the "dm_control" backend; all
            tensors have it as their first dimension.
        seed: seed of all random numbers, those of transforms included. By default each environment
            draws its own, so that workers differ; it is in `env.seed`.
        drop: names of transforms to leave out. Without a reward term, rewards are smaller, but
            `LowReward` still ends episodes below 0.3: consider dropping or replacing it, too.
        replace: name of a transform in the stack -> transform.
        stack: stack, or the name of one in `STACKS`. The environment gets copies of its transforms,
            so that several environments may be made of it.
        reward_on: state that rewards read, "truth" or "estimate"; for stacks given by name.
        library: gait library, by default the stack's own; for stacks given by name.
        keep: entries of the transitions, all by default. With `["observation"]` transitions are
            small; action, reward, flags of ends and `command` always stay. See `KeepKeys`.
        base: `RobotEnv` instead of a simulator, or function of `num_envs` that makes it; see
            `robot_stack` for real robots and replayed logs.
        num_threads: physics threads of the batch backend, 0 for all processors that this process
            may use, by its affinity and the quota of its container.
        device: device of the warp backend, and of all its entries; "cpu" is for tests.
        floor_friction: sliding friction of the floor.
        timestep: physics timestep of the batch and warp backends [s], 0.0005 or the faster 0.001.

    Raises:
        ConfigurationError: a setting is invalid, two settings exclude each other, or a transform
            has no effect at its place.
        UnknownNameError: a stack or transform of that name does not exist, or a transform reads an
            entry that no other writes.
    """
    seed = random_seed() if seed is None else check_seed(seed)
    chosen = edit_stack(_find_stack(stack, library, reward_on), drop, replace or {})
    simulator: dict[str, Any] = {"floor_friction": floor_friction, "timestep": timestep}
    simulator |= {"num_threads": num_threads, "device": device}
    if base is None:
        robot = _make_simulator(backend, num_envs, **simulator)
    else:
        robot = _make_robot(base, num_envs, {"backend": backend, **simulator})
    env = StackEnv(robot, {name: _copy(transform) for name, transform in chosen.items()})
    check_wiring(env)
    if keep is not None:
        _hide_others(env, [keep] if isinstance(keep, str) else list(keep))
    env.set_seed(seed)
    return env


def _copy(transform: Transform) -> Transform:
    """Copy of a transform that shares gait libraries and networks, but nothing that changes.

    Copies of TorchRL (`clone`) share lists, dicts and tensors, too.
    """
    copied = transform.clone()
    for part in copied.modules():
        if isinstance(part, Transform):
            vars(part).update({name: _own(value) for name, value in vars(part).items()})
            part._buffers = {name: _own(value) for name, value in part._buffers.items()}
    return copied


def _own(value: Any) -> Any:
    """Copy of a list, dict or tensor; other values themselves."""
    if isinstance(value, Tensor) and not is_lazy(value):
        return value.clone()
    return copy(value) if isinstance(value, list | dict | Tensor) else value


def _hide_others(env: StackEnv, keep: list[NestedKey]) -> None:
    """Hide all entries but `keep` and those that TorchRL requires.

    Raises:
        UnknownNameError: an entry of `keep` does not exist.
    """
    spec = env.observation_spec
    known = set(spec.keys(True))
    for key in keep:
        if unravel_key(key) not in known:
            raise UnknownNameError.among("entry", key, sorted(map(str, known)))
    # recurrent policies and collectors read is_init
    requested = [*env.state_spec.keys(True, True), *(key for key in ("is_init",) if key in spec)]
    env.append_transform(KeepKeys([*keep, *requested]))


def _find_stack(
    stack: Mapping[str, Transform] | str, library: GaitLibrary | None, reward_on: RewardSource
) -> Stack:
    """Stack of a name; a stack is returned as it is."""
    if reward_on not in get_args(RewardSource):
        raise ConfigurationError(
            f"reward_on must be one of {get_args(RewardSource)}, got {reward_on!r}"
        )
    if isinstance(stack, str):
        if stack not in STACKS:
            raise UnknownNameError.among("stack", stack, sorted(STACKS))
        return STACKS[stack](library, reward_on)
    if library is not None or reward_on != "truth":
        raise ConfigurationError(
            "library and reward_on need a stack given by name; for another stack, pass them to the"
            " function that makes it, such as default_stack(library, reward_on)"
        )
    return dict(stack)


def _make_simulator(
    backend: Backend,
    num_envs: int,
    *,
    floor_friction: float,
    timestep: float,
    num_threads: int,
    device: str,
) -> SimulatedEnv:
    if backend not in get_args(Backend):
        raise ConfigurationError(f"backend must be one of {get_args(Backend)}, got {backend!r}")
    physics: dict[str, Any] = {"floor_friction": floor_friction, "timestep": timestep}
    if backend == "batch":
        return BatchEnv(num_envs, num_threads=num_threads, **physics)
    if backend == "warp":
        from aslip.envs import WarpEnv  # MuJoCo Warp takes seconds to import

        return WarpEnv(num_envs, device=device, **physics)
    if timestep != CASSIE.physics_timestep:
        raise ConfigurationError(
            f"timestep of the dm_control backend must be {CASSIE.physics_timestep} s,"
            f" got {timestep!r}"
        )
    from aslip.envs import DmControlEnv  # dm_control takes half a second to import

    return DmControlEnv(num_envs, floor_friction=floor_friction)


def _make_robot(
    base: RobotEnv | Callable[..., RobotEnv], num_envs: int, simulator: Mapping[str, Any]
) -> RobotEnv:
    """Robot environment of the caller.

    Raises:
        ConfigurationError: `base` is not a `RobotEnv` and makes none, has another number of robots,
            or comes with settings of a simulator.
    """
    defaults = signature(make_env).parameters
    for name, value in simulator.items():
        if value != defaults[name].default:
            raise ConfigurationError(
                f"{name} is a setting of this package's simulators; with base, set it where base is"
                " made"
            )
    robot = base if isinstance(base, EnvBase) else base(num_envs=num_envs)
    if not isinstance(robot, RobotEnv):
        raise ConfigurationError(f"base must be a RobotEnv or make one, got {type(robot).__name__}")
    if num_envs not in (1, robot.num_envs):
        raise ConfigurationError(f"base has {robot.num_envs} robots, but num_envs is {num_envs}")
    return robot
