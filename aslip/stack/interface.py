"""What an environment is to a policy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from functools import partial
from types import FunctionType, MethodType
from typing import Any, TypeVar

import torch
from tensordict.utils import NestedKey
from torchrl.envs.transforms import RewardSum, StepCounter, Transform

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.stack.code_hash import function_text
from aslip.stack.environment import CassieTransformedEnv
from aslip.stack.stacks import STACKS
from aslip.transforms import (
    AssembleObservation,
    EpisodeSum,
    EstimatedState,
    Fall,
    HeadingFrame,
    LowReward,
    ObservationNoise,
    RandomDynamics,
    ReferenceStart,
    RewardTerm,
    SpeedCommand,
    TrueState,
    WeightedReward,
)


def acts_on(env: CassieTransformedEnv) -> str | None:
    """Name of the stack in `STACKS` that is the same to a policy; None if no stack is.

    Which rewards there are, when episodes end, and what robots and sensors are like makes no
    difference; what the policy observes, and what becomes of its action, does.
    """
    has = _interface(env.transforms)
    for name, make in STACKS.items():
        stack = make()
        if has == _interface([t() for t in stack.values()]):
            return name
    return None


def observed(env: CassieTransformedEnv) -> list[NestedKey]:
    """Keys of the entries of an environment's observation, in order.

    Raises:
        ConfigurationError: no `AssembleObservation` makes one.
    """
    return list(_only(env, AssembleObservation).in_keys)


def commanded(env: CassieTransformedEnv) -> list[float]:
    """Speeds that an environment may command [m/s], each once.

    Raises:
        ConfigurationError: no `SpeedCommand` commands any.
    """
    speeds = _only(env, SpeedCommand).speeds.tolist()
    return list(dict.fromkeys(round(speed, 6) for speed in speeds))


def described(env: CassieTransformedEnv) -> dict[str, str]:
    """What an environment is made of: name of a transform -> its class, and what it was told.

    Functions are told by name and a hash of their code (`function_text`), and whatever else has no
    short text by its class.
    """
    return {
        name: f"{type(t).__name__}({', '.join(_told(t))})"
        for name, t in zip(env.transform_names, env.transforms, strict=True)
    }


def _told(transform: Transform) -> list[str]:
    """Public attributes of a transform that TorchRL does not give to all."""
    usual = vars(Transform())
    keys = {key: getattr(transform, key) for key in ("in_keys", "out_keys")}
    own = {
        name: value
        for name, value in {**vars(transform), **dict(transform.named_buffers())}.items()
        if not name.startswith("_") and name not in usual and name not in _LEFT_OUT
    }
    return [f"{name}={_text(value)}" for name, value in sorted({**keys, **own}.items())]


# what follows from others, or changes while a training goes on
_LEFT_OUT = ("generator", "next_keys", "root_keys")


def _text(value: Any) -> str:
    if isinstance(value, torch.Tensor):
        return str([round(number, 6) for number in value.flatten().tolist()])
    if isinstance(value, Mapping):
        return str({str(key): _text(item) for key, item in value.items()})
    if isinstance(value, GaitLibrary):
        return f"{len(value.speeds)} motions from {value.speeds[0]:g} to {value.speeds[-1]:g} m/s"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, str | int | float | None) or is_dataclass(value):
        return str(value)
    if isinstance(value, FunctionType | MethodType | partial):
        return function_text(value, _text)
    return getattr(value, "__qualname__", type(value).__name__)


Kind = TypeVar("Kind", bound=Transform)


def _only(env: CassieTransformedEnv, kind: type[Kind]) -> Kind:
    """The transform of a kind."""
    for transform in env.transforms:
        if isinstance(transform, kind):
            return transform
    raise ConfigurationError(
        f"the stack lacks a {kind.__name__}, or a subclass; it has {list(env.transform_names)}"
    )


# these change neither what a policy observes nor what becomes of its action
_NO_INTERFACE = (
    *(RewardTerm, WeightedReward, EpisodeSum, RewardSum, Fall, LowReward, StepCounter),
    *(ReferenceStart, HeadingFrame, SpeedCommand, RandomDynamics),
    *(ObservationNoise, EstimatedState, TrueState),
)


def _interface(transforms: Iterable[Transform]) -> list[tuple[Any, ...]]:
    """What transforms are to a policy, to be compared."""
    kept = [t for t in transforms if not isinstance(t, _NO_INTERFACE)]
    return [
        (type(t), t.in_keys, t.out_keys, _motion(getattr(t, "library", None)))
        for t in kept
        if t.in_keys or t.out_keys  # otherwise it only looks on
    ]


def _motion(library: GaitLibrary | None) -> list[list[float]]:
    """Numbers that tell a library from others: its motion at some points of the stride."""
    if library is None:
        return []
    lowest, *_, highest = library.speeds.tolist()
    points = torch.cartesian_prod(torch.arange(4) / 4, torch.linspace(lowest, highest, 3))
    motion = library.lookup(points[:, :1], points[:, 1:])
    return torch.cat([points, motion.motor_position, motion.body_velocity], dim=-1).tolist()
