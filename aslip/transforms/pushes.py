"""Random pushes on the pelvis, for the training of robust policies."""

from __future__ import annotations

import math
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.base.checks import check_number
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, check_interval, extend_spec, require_keys
from aslip.transforms.curriculum import difficulty_of


class RandomPushes(SeededTransform):
    """Push pelvises horizontally at random times, in random directions, with random impulses.

    At each policy step without a push, one begins with the same probability. Its force is constant,
    and its impulse uniform between zero and the largest. No push begins at a reset.

    Writes `push` (n, 3), the force during the next policy step [N, world], and `push_steps` (n, 1),
    the number of policy steps that it still acts.

    Args:
        impulse: largest impulse of a push [N s].
        interval: mean time from the end of a push to the next [s].
        duration: duration of a push [s], rounded to whole policy steps.
        difficulty_key: key of the difficulty (n, 1) that scales the impulses, see
            `aslip.transforms.Difficulty`.

    Raises:
        ConfigurationError: `impulse` is negative, or `interval` or `duration` is shorter than a
            policy step.
    """

    needs_env = "it pushes simulated robots"

    def __init__(
        self,
        impulse: float = 15.0,
        interval: float = 5.0,
        duration: float = 0.21,
        *,
        difficulty_key: NestedKey | None = None,
    ) -> None:
        keys = [] if difficulty_key is None else [difficulty_key]
        super().__init__(keys, ["push", "push_steps"])
        self.difficulty_key = difficulty_key
        self.impulse = check_number("impulse", impulse, 0.0, what="in N s")
        self.interval = check_interval(interval)
        self.duration = check_number("duration", duration, CASSIE.policy_period, what="in s")
        self._steps = round(self.duration / CASSIE.policy_period)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        for key, size in zip(self.out_keys, (3, 1), strict=True):
            tensordict_reset.set(key, torch.zeros(*tensordict_reset.batch_size, size))
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        # entries that a caller left out, as `next_start` leaves out pushes, count as no push
        shape = (*tensordict.batch_size, 1)
        force, steps = (
            cast("Tensor", tensordict.get(key, torch.zeros(*shape[:-1], size)))
            for key, size in zip(self.out_keys, (3, 1), strict=True)
        )
        steps = (steps - 1).clamp(min=0)
        chance, share, turn = torch.rand((*shape[:-1], 3), generator=self.generator).split(1, -1)
        begins = (steps == 0) & (chance < CASSIE.policy_period / self.interval)
        angle = 2 * math.pi * turn
        size = share * self.impulse / (self._steps * CASSIE.policy_period)
        size = size * difficulty_of(tensordict, self.difficulty_key)
        drawn = size * torch.cat([angle.cos(), angle.sin(), torch.zeros(shape)], dim=-1)
        force = torch.where(begins, drawn, torch.where(steps > 0, force, 0.0))
        next_tensordict.set(self.out_keys[0], force)
        return next_tensordict.set(self.out_keys[1], torch.where(begins, self._steps, steps))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the force and its remaining policy steps."""
        require_keys(self, observation_spec, self.in_keys)
        return extend_spec(observation_spec, dict(zip(self.out_keys, (3, 1), strict=True)))
