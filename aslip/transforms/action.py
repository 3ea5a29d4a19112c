"""Motor targets from the policy's action, and the action of the last policy step."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite

from aslip.base.checks import TINY, check_number
from aslip.errors import ShapeError
from aslip.transforms.base import SeededTransform, extend_spec, require_keys


class ActionDelta(SeededTransform):
    r"""Add the policy's action to a baseline: motor targets :math:`\hat a + a` (Sec. III-B).

    The action is neither clipped, scaled nor filtered, as in the paper. The default baseline is the
    reference's motor angles; `baseline_key` names another one, such as the targets of
    `Feedforward`. A robot whose action is not finite counts as diverged.

    The action spec has bounds nevertheless: algorithms that squash their actions, and random
    actions, need them. They clip nothing.

    Args:
        baseline_key: key of the angles (n, m) to which the action is added [rad].
        limit: bound +- `limit` of the action spec [rad].

    Raises:
        ConfigurationError: `limit` is not a finite number above 0.
    """

    def __init__(
        self,
        baseline_key: NestedKey = ("reference", "motor_position"),
        *,
        limit: float = math.pi / 2,
    ) -> None:
        super().__init__(in_keys=[baseline_key], out_keys=[])
        self.in_keys_inv, self.out_keys_inv = ["motor_target"], ["action"]
        self.baseline_key = baseline_key
        self.limit = check_number("limit", limit, TINY, what="in rad")

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        baseline, action = tensordict[self.baseline_key], tensordict[self.out_keys_inv[0]]
        return tensordict.set(self.in_keys_inv[0], add_delta(baseline, action))

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Replace the motor targets by the action."""
        (target,), (action,) = self.in_keys_inv, self.out_keys_inv
        shape = action_spec[target].shape
        high = torch.full(shape, self.limit, dtype=torch.float32)
        del action_spec[target]
        action_spec[action] = Bounded(-high, high, shape=shape, dtype=torch.float32)
        return action_spec


def add_delta(baseline: Tensor, action: Tensor) -> Tensor:
    """Motor targets (*b, m): baseline plus action; NaN where the action is not finite [rad].

    Raises:
        ShapeError: the action and the baseline differ in shape.
    """
    if action.shape != baseline.shape:
        raise ShapeError(
            f"action must have shape {tuple(baseline.shape)}, got {tuple(action.shape)}"
        )
    return baseline + torch.where(action.isfinite(), action, torch.nan)


class LastAction(SeededTransform):
    """Write the action of the last policy step as `last_action` (n, m); zero after a reset."""

    def __init__(self) -> None:
        super().__init__(in_keys=["action"], out_keys=["last_action"])
        self._size = 0

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        shape = (*tensordict_reset.batch_size, self._size or self._action_size())
        zeros = torch.zeros(shape, dtype=torch.float32)
        return tensordict_reset.set(self.out_keys[0], zeros)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.out_keys[0], tensordict[self.in_keys[0]].detach())

    def _action_size(self) -> int:
        """Length of the environment's action."""
        parent = self.parent
        if parent is None:
            raise RuntimeError("LastAction needs an environment; add it to one first")
        require_keys(self, parent.full_action_spec, self.in_keys)
        return parent.full_action_spec[self.in_keys[0]].shape[-1]

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the last action."""
        self._size = self._action_size()
        return extend_spec(observation_spec, {self.out_keys[0]: self._size})
