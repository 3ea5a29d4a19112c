"""From the policy's output to motor targets, and its memory."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite

from aslip.cassie import MOTOR_NAMES
from aslip.errors import ShapeError
from aslip.transforms.base import CassieTransform, extend_spec


class ActionDelta(CassieTransform):
    r"""The policy's delta on the reference's motor angles: :math:`a = \hat a + \delta_a`.

    (Sec. III-B.) The delta is unbounded, unscaled and unfiltered, as in the paper. To act on
    another baseline, such as what `Feedforward` writes, name its key. A robot whose action is not
    finite counts as diverged: no motor could take it.

    Args:
        baseline_key: (*b, 10) angles to add the delta to [rad].
    """

    def __init__(self, baseline_key: NestedKey = ("reference", "motor_position")) -> None:
        super().__init__(in_keys=[baseline_key], out_keys=[])
        self.baseline_key = baseline_key

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"]
        expected = (*tensordict.batch_size, len(MOTOR_NAMES))
        if action.shape != expected:
            raise ShapeError(f"action must have shape {expected}, got {tuple(action.shape)}")
        finite = torch.where(action.isfinite(), action, torch.nan)
        return tensordict.set("motor_target", tensordict[self.baseline_key] + finite)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Offer `action` in place of `motor_target`."""
        action_spec["action"] = action_spec["motor_target"].clone()
        del action_spec["motor_target"]
        return action_spec


class LastAction(CassieTransform):
    """Remember the previous action under `last_action`; zero, no delta, after a reset."""

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=["last_action"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        shape = (*tensordict_reset.batch_size, len(MOTOR_NAMES))
        zeros = torch.zeros(shape, dtype=torch.float32)
        return tensordict_reset.set("last_action", zeros)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("last_action", tensordict["action"].detach())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add `last_action`."""
        return extend_spec(observation_spec, {"last_action": len(MOTOR_NAMES)})
