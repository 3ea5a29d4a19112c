"""Curriculum: training begins with nominal robots; ranges and pushes grow with policy steps."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from aslip.base.checks import check_count
from aslip.errors import ConfigurationError
from aslip.transforms.base import ChosenAtReset, checked_column


class Difficulty(ChosenAtReset):
    """Write `difficulty` (n, 1) of training, from 0 to 1, which rises with a robot's policy steps.

    `RandomDynamics`, which must come earlier in the stack, and `RandomPushes`, which must come
    later, narrow their ranges by it if they read it. It carries over from episode to episode: a
    reset with a mask keeps it, also if its request has nothing but the mask (`StackEnv` adds the
    latest entries to such requests). A reset without mask and entry starts again at 0, or where
    `resume` says; to choose a value, pass it to the reset or write it between steps.

    Args:
        ramp: policy steps of a robot until the difficulty is 1.

    Raises:
        ConfigurationError: `ramp` is not a whole number of 1 or more.
    """

    needs_env = "it carries over resets"

    def __init__(self, ramp: int) -> None:
        super().__init__([], {"difficulty": 1})
        self.ramp = check_count("ramp", ramp)
        self._start = 0.0

    def resume(self, steps: int) -> None:
        """Start as robots that have taken a number of policy steps in earlier environments."""
        self._start = min(steps / self.ramp, 1.0)

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        request = self._request(tensordict)
        if request.get("difficulty", None) is None:
            request.set("difficulty", torch.full((*request.batch_size, 1), self._start))
        return request.set("difficulty", checked_column(request, "difficulty"))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        harder = checked_column(tensordict, "difficulty") + 1 / self.ramp
        return next_tensordict.set("difficulty", harder.clamp(max=1.0))


def difficulty_of(tensordict: TensorDictBase, key: NestedKey | None) -> Tensor | float:
    """Difficulty (*b, 1) at a key; 1 without a key.

    Raises:
        ConfigurationError: the tensordict lacks the key.
    """
    if key is None:
        return 1.0
    difficulty = tensordict.get(key, None)
    if difficulty is None:
        raise ConfigurationError(
            f"no difficulty at {key!r}: a stack needs Difficulty after RandomDynamics, as"
            " TorchRL prepares resets from the last transform to the first"
        )
    return cast("Tensor", difficulty)
