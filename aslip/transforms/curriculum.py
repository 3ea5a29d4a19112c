"""Curriculum: training begins with easy robots, and becomes harder with experience."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.errors import ConfigurationError
from aslip.transforms.base import SeededTransform, checked_column, extend_spec


class Difficulty(SeededTransform):
    """Write `difficulty` (n, 1) of training, from 0 to 1, which rises with a robot's policy steps.

    `RandomDynamics`, which must come earlier in the stack, and `RandomPushes`, which must come
    later, narrow their ranges by it if they read it. It carries over from episode to episode, also
    in TorchRL's resets of robots that are done, whose request has nothing but a mask. A reset
    without mask and entry starts again at 0, or where `resume` says; to choose a value, pass it to
    the reset or write it between steps. The transform keeps the last value, as those requests lack
    it; each step takes it from the tensordict, so that episodes may go on in another environment.

    Args:
        ramp: policy steps of a robot until the difficulty is 1.

    Raises:
        ConfigurationError: `ramp` is not a whole number of 1 or more.
    """

    num_in_keys, num_out_keys = 0, 1
    needs_env = "it carries over resets"

    def __init__(self, ramp: int) -> None:
        super().__init__(in_keys=[], out_keys=["difficulty"])
        if isinstance(ramp, bool) or not isinstance(ramp, int) or ramp < 1:
            raise ConfigurationError(f"ramp must be a whole number of 1 or more, got {ramp!r}")
        self.ramp = ramp
        self._start = 0.0
        self._reached: Tensor | None = None

    def resume(self, steps: int) -> None:
        """Start as robots that have taken a number of policy steps in earlier environments."""
        self._start = min(steps / self.ramp, 1.0)

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        tensordict, key = self._request(tensordict), self.out_keys[0]
        if tensordict.get(key, None) is None:
            kept = self._reached if "_reset" in tensordict else None
            start = torch.full((*tensordict.batch_size, 1), self._start, dtype=torch.float32)
            tensordict.set(key, start if kept is None else kept)
        return tensordict.set(key, checked_column(tensordict, key))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        begun, mask = cast("Tensor", tensordict[self.out_keys[0]]), tensordict.get("_reset", None)
        if mask is None or self._reached is None:
            self._reached = begun.clone()
        else:
            self._reached = torch.where(mask.reshape(-1, 1), begun, self._reached)
        return tensordict_reset.set(self.out_keys[0], begun)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        harder = checked_column(tensordict, self.out_keys[0]) + 1 / self.ramp
        self._reached = harder.clamp(max=1.0)
        return next_tensordict.set(self.out_keys[0], self._reached.clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the difficulty."""
        return extend_spec(observation_spec, {self.out_keys[0]: 1})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the difficulty as an entry that a caller may set."""
        return extend_spec(state_spec, {self.out_keys[0]: 1})


def difficulty_of(tensordict: TensorDictBase, keys: Sequence[NestedKey]) -> Tensor | float:
    """Difficulty (*b, 1) at the only key of a list; 1 for an empty list.

    Raises:
        ConfigurationError: there are several keys, or the tensordict lacks the key.
    """
    if not keys:
        return 1.0
    if len(keys) > 1:
        raise ConfigurationError(f"the difficulty has one key, got {list(keys)}")
    found = tensordict.get(keys[0], None)
    if found is None:
        raise ConfigurationError(
            f"no difficulty at {keys[0]!r}: a stack needs Difficulty after RandomDynamics, as"
            " TorchRL prepares resets from the last transform to the first"
        )
    return cast("Tensor", found)
