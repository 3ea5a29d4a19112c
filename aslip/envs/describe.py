"""Properties of an environment: observed entries, commanded speeds, gait library, transforms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import partial
from typing import Any, TypeVar

import torch
from tensordict.utils import NestedKey
from torchrl.envs.transforms import Transform

from aslip.envs.stack_env import StackEnv
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.transforms import AssembleObservation, PhaseClock, SpeedCommand, StandClock


def observation_keys(env: StackEnv) -> list[NestedKey]:
    """Keys of the entries of an environment's observation, in order.

    Raises:
        ConfigurationError: the stack has no `AssembleObservation`.
    """
    return list(_only(env, AssembleObservation).in_keys)


def command_speeds(env: StackEnv) -> list[float]:
    """Distinct speeds that an environment may command [m/s].

    Raises:
        ConfigurationError: the stack has no `SpeedCommand`.
    """
    speeds = _only(env, SpeedCommand).speeds.tolist()
    return list(dict.fromkeys(round(speed, 6) for speed in speeds))


def library_of(env: StackEnv) -> GaitLibrary:
    """Gait library whose strides the clock of an environment follows.

    Raises:
        ConfigurationError: the stack has no clock.
    """
    return _only(env, PhaseClock, StandClock).library


def describe_transforms(env: StackEnv) -> dict[str, str]:
    """Transforms of an environment: name -> class and settings.

    A function is described by its qualified name, so a change of its code does not show; a value
    without a short text by its class.
    """
    return {
        name: f"{type(t).__name__}({', '.join(_settings(t))})"
        for name, t in zip(env.transform_names, env.transforms, strict=True)
    }


def _settings(transform: Transform) -> list[str]:
    """Public attributes of a transform beyond those of TorchRL's `Transform`."""
    usual = vars(Transform())
    keys = {key: getattr(transform, key) for key in ("in_keys", "out_keys")}
    own = {
        name: value
        for name, value in {
            **vars(transform),
            **dict(transform.named_buffers(recurse=False)),
            **dict(transform.named_children()),
        }.items()
        if not name.startswith("_") and name not in usual and name not in _LEFT_OUT
    }
    return [f"{name}={_text(value)}" for name, value in sorted({**keys, **own}.items())]


# attributes that follow from others, or change during a training
_LEFT_OUT = ("generator", "next_keys", "root_keys")


def _text(value: Any) -> str:
    if isinstance(value, torch.Tensor):
        return str([round(number, 6) for number in value.flatten().tolist()])
    if isinstance(value, Mapping):
        return str({str(key): _text(item) for key, item in value.items()})
    if isinstance(value, GaitLibrary):
        return f"{len(value.table.strides)} motions, SHA-256 {value.sha256[:12]}"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, str | int | float | None) or is_dataclass(value):
        return str(value)
    if isinstance(value, partial):
        given = ", ".join([*map(_text, value.args), _text(value.keywords)])
        return f"partial({_text(value.func)}, {given})"
    return getattr(value, "__qualname__", type(value).__name__)


Kind = TypeVar("Kind", bound=Transform)


def _only(env: StackEnv, *kinds: type[Kind]) -> Kind:
    """First transform of one of some classes.

    Raises:
        ConfigurationError: the stack has none.
    """
    for transform in env.transforms:
        if isinstance(transform, kinds):
            return transform
    names = " or ".join(kind.__name__ for kind in kinds)
    raise ConfigurationError(
        f"the stack lacks a {names}; its transforms are {list(env.transform_names)}"
    )
