"""Random footsteps, on which policies learn to step where a planner says."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.base.checks import check_number
from aslip.planning import WalkState
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, check_interval, extend_spec, require_keys
from aslip.transforms.curriculum import difficulty_of

# time before a touchdown in which its foothold is not drawn again [s]
_LATE = 0.12


class RandomFootsteps(SeededTransform):
    """Displace the next foothold at random: `("footsteps", "shift")` (n, 2) [m, heading frame].

    A `PlannedReference` after it in the stack lets the foot land that far from the best foothold,
    as stones would. A displacement is normally distributed and holds for a step, unless it is drawn
    again in flight; some steps have none.

    Args:
        ahead: standard deviation ahead [m].
        sideways: standard deviation sideways [m].
        share: probability with which a step has a displacement.
        interval: mean time between draws in flight [s].
        difficulty_key: key of the difficulty (n, 1) that scales the displacements, see
            `aslip.transforms.Difficulty`.

    Raises:
        ConfigurationError: a deviation is negative, `share` no share, or `interval` shorter than a
            policy step.
    """

    needs_env = "displacements belong to the steps of robots"

    def __init__(
        self,
        ahead: float = 0.1,
        sideways: float = 0.05,
        *,
        share: float = 0.7,
        interval: float = 2.0,
        difficulty_key: NestedKey | None = None,
    ) -> None:
        keys: list[NestedKey] = [] if difficulty_key is None else [difficulty_key]
        super().__init__(keys, [("footsteps", "shift")])
        names = {"ahead": ahead, "sideways": sideways}
        self._spread = torch.tensor(
            [check_number(n, v, 0.0, what="in m") for n, v in names.items()]
        )
        self.share = check_number("share", share, 0.0, 1.0)
        self.interval = check_interval(interval)
        self._difficulty_key = difficulty_key

    def _drawn(self, tensordict: TensorDictBase) -> Tensor:
        shape = tensordict.batch_size
        normal = torch.randn((*shape, 2), generator=self.generator)
        chance = torch.rand((*shape, 1), generator=self.generator)
        size = self._spread * difficulty_of(tensordict, self._difficulty_key)
        return torch.where(chance < self.share, size * normal, 0.0)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return tensordict_reset.set(self.out_keys[0], self._drawn(tensordict_reset))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        time = cast("Tensor", tensordict["plan", "time"])
        chance = torch.rand(time.shape, generator=self.generator)
        again = (chance < CASSIE.policy_period / self.interval) & (time > _LATE)
        # of the foot that has landed, also before its time
        landed = WalkState.from_rows(cast("Tensor", tensordict["plan", "state"])).since
        again |= landed[:, None] <= CASSIE.policy_period + 1e-6
        shift = torch.where(
            again, self._drawn(next_tensordict), cast("Tensor", tensordict[self.out_keys[0]])
        )
        return next_tensordict.set(self.out_keys[0], shift)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the displacement."""
        require_keys(self, observation_spec, self.in_keys)
        return extend_spec(observation_spec, {self.out_keys[0]: 2})
