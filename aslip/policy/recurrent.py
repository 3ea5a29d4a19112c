"""Recurrent policies: a GRU between normaliser and perceptron, and the environment it needs.

    env = add_memory(aslip.make_env(num_envs=8), actor)
    env.rollout(100, actor)

The entry `memory` is the hidden state: the policy writes it for the next policy step, and the
environment sets it to zero when the robot is reset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from tensordict.utils import NestedKey
from torch import nn
from torchrl.data import Composite
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose, InitTracker, TensorDictPrimer
from torchrl.modules import GRUModule, ProbabilisticActor
from torchrl.modules.utils import get_primers_from_module

from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError
from aslip.policy.networks import (
    PolicyShape,
    RunningNormalizer,
    action_layers,
    action_scale,
    gaussian_actor,
)
from aslip.transforms import OBSERVATION_TABLE

Env = TypeVar("Env", bound=TransformedEnv)
Policy = TypeVar("Policy", bound=nn.Module)


@on_cpu_in_single
def make_recurrent_actor(
    normalizer: RunningNormalizer,
    shape: PolicyShape | None = None,
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
) -> ProbabilisticActor:
    """GRU policy: `observation`, `memory` -> `action`, and `memory` of the next policy step.

    The first of the shape's hidden layers is the GRU.

    Args:
        normalizer: shared with the critic.
        shape: sizes and standard deviation.
        observation: keys of the observation's entries; not used, as there is no symmetry.

    Raises:
        ConfigurationError: the shape is symmetric, or has no hidden layer.
    """
    shape = shape or PolicyShape()
    if shape.symmetric:
        raise ConfigurationError(
            "a recurrent policy cannot be symmetric: set symmetric=False (--no-symmetric)"
        )
    if not shape.hidden:
        raise ConfigurationError("a recurrent policy needs a hidden layer, got hidden=()")
    width, *rest = shape.hidden
    memory = GRUModule(
        input_size=shape.observation_size,
        hidden_size=width,
        in_keys=["normalised", "memory", "is_init"],
        out_keys=["features", ("next", "memory")],
    )
    head = nn.Sequential(action_layers(shape, width, rest), action_scale(shape))
    modules: list[Any] = [
        TensorDictModule(normalizer, in_keys=["observation"], out_keys=["normalised"]),
        memory,
        TensorDictModule(head, in_keys=["features"], out_keys=["loc", "scale"]),
    ]
    return require_memory(gaussian_actor(TensorDictSequential(*modules)))


def require_memory(policy: Policy) -> Policy:
    """Make a recurrent policy refuse to act without its hidden state, after a first policy step.

    Environments without `add_memory` drop the state, and the policy would silently act from zero
    at each step.

    Args:
        policy: any policy; changed in place.
    """
    for part in policy.modules():
        if hasattr(part, "make_tensordict_primer"):
            part.register_forward_pre_hook(_check_memory)
    return policy


def _check_memory(part: nn.Module, inputs: tuple[Any, ...]) -> None:
    """Check that a recurrent part of a policy finds its hidden state.

    Raises:
        ConfigurationError: the state is missing, and a robot is not at its first policy step; or
            nothing marks first policy steps.
    """
    td = inputs[0] if inputs else None
    # a whole sequence may begin without a state
    if not isinstance(td, TensorDictBase) or getattr(part, "recurrent_mode", False):
        return
    states = [key[1:] for key in cast("Any", part).out_keys if key[0] == "next"]
    lost = [key[0] for key in states if td.get(key, None) is None]
    first = td.get("is_init", None)
    if first is None or (lost and not first.all()):
        raise ConfigurationError(
            f"a recurrent policy lacks {lost or 'is_init'}: the environment drops its hidden state;"
            " prepare it once, before its first reset: aslip.policy.add_memory(env, policy)"
        )


def is_recurrent(policy: Callable[..., Any]) -> bool:
    """Check whether a policy has a hidden state, as TorchRL's `GRUModule` and `LSTMModule` do."""
    parts = policy.modules() if isinstance(policy, nn.Module) else ()
    return any(hasattr(part, "make_tensordict_primer") for part in parts)


@on_cpu_in_single
def add_memory(env: Env, policy: Callable[..., Any]) -> Env:
    """Append the transforms that a recurrent policy needs; other policies need none.

    `InitTracker` marks first policy steps as `is_init`, and a `TensorDictPrimer` holds the hidden
    state. An environment that already has them is not changed.

    Args:
        env: environment of any stack; changed in place.
        policy: the policy; a function has no hidden state.

    Returns:
        The same environment.

    Raises:
        ConfigurationError: the environment has the hidden state of a policy with other sizes.
    """
    if not is_recurrent(policy):
        return env
    spec = env.observation_spec
    has = set(spec.keys(True, True))
    for key, shape in _memory_shapes(policy).items():
        kept = spec[key].shape[len(env.batch_size) :] if key in has else shape
        if kept != shape:
            raise ConfigurationError(
                f"the policy's hidden state {key!r} has shape {tuple(shape)}, and the environment"
                f" has that of another policy, {tuple(kept)}; make a new environment"
            )
    if "is_init" not in has:
        env.append_transform(InitTracker())
    for primer in _primers(policy):
        assert primer.primers is not None
        if not set(primer.primers.keys()) <= has:
            env.append_transform(primer)
    return env


@on_cpu_in_single
def forget(td: TensorDictBase, policy: Callable[..., Any]) -> TensorDictBase:
    """Set the hidden state of a recurrent policy to zero, as at a first policy step, in place.

    Args:
        td: the environment's tensordict before a policy step; returned.
        policy: the policy; one without a hidden state changes nothing.
    """
    if is_recurrent(policy):
        td["is_init"] = torch.ones(*td.batch_size, 1, dtype=torch.bool)
    for key, shape in _memory_shapes(policy).items():
        td[key] = torch.zeros(*td.batch_size, *shape)
    return td


def _primers(policy: Callable[..., Any]) -> list[TensorDictPrimer]:
    """Transforms that hold the hidden state of a policy."""
    if not is_recurrent(policy):
        return []
    primers = get_primers_from_module(policy)
    listed = [*primers] if isinstance(primers, Compose) else [primers]
    return [primer for primer in listed if isinstance(primer, TensorDictPrimer)]


def _memory_shapes(policy: Callable[..., Any]) -> dict[NestedKey, torch.Size]:
    """Shape of each entry of a policy's hidden state, of one robot."""
    specs = [cast("Composite", primer.primers) for primer in _primers(policy)]
    return {key: spec[key].shape for spec in specs for key in spec.keys(True, True)}
