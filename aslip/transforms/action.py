"""From the policy's output to motor targets, and its memory."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, extend_spec


class ActionDelta(SeededTransform):
    r"""The policy's delta on the reference's motor angles: :math:`a = \hat a + \delta_a`.

    (Sec. III-B.) The delta is unbounded, unscaled and unfiltered, as in the paper. To act on
    another baseline, such as what `Feedforward` writes, name its key. A robot whose action is not
    finite counts as diverged: no motor could take it.

    The action spec is bounded all the same, for algorithms that scale their actions to it and for
    random actions. The bound describes and never clips: what a policy sends is what is added. The
    shipped policies walk with deltas of up to 0.95 rad (aslip) and 1.21 rad (robust).

    Args:
        baseline_key: (*b, 10) angles to add the delta to [rad].
        limit: bound of the action spec, to either side, for all motors or for each of them [rad].

    Raises:
        ConfigurationError: the limit is not one or ten finite numbers above 0.
    """

    def __init__(
        self,
        baseline_key: NestedKey = ("reference", "motor_position"),
        *,
        limit: float | Sequence[float] = math.pi / 2,
    ) -> None:
        super().__init__(in_keys=[baseline_key], out_keys=[])
        self.baseline_key = baseline_key
        self.limit = _checked(limit)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        target = add_delta(tensordict[self.baseline_key], tensordict["action"])
        return tensordict.set("motor_target", target)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Offer `action` in place of `motor_target`."""
        shape = action_spec["motor_target"].shape
        high = torch.tensor(self.limit, dtype=torch.float32).expand(shape)
        action_spec["action"] = Bounded(-high, high, shape=shape, dtype=torch.float32)
        del action_spec["motor_target"]
        return action_spec


def add_delta(baseline: Tensor, action: Tensor) -> Tensor:
    """Motor targets (*b, m): baseline plus action; NaN where the action is not finite [rad].

    Raises:
        ShapeError: the action has another shape than the baseline.
    """
    if action.shape != baseline.shape:
        raise ShapeError(
            f"action must have shape {tuple(baseline.shape)}, got {tuple(action.shape)}"
        )
    return baseline + torch.where(action.isfinite(), action, torch.nan)


def _checked(limit: float | Sequence[float]) -> float | tuple[float, ...]:
    """One number above 0, or one a motor.

    Raises:
        ConfigurationError: it is anything else.
    """
    try:
        values = np.atleast_1d(np.asarray(limit, dtype=np.float64))
    except (TypeError, ValueError):
        values = np.zeros(0)
    right_size = values.shape in {(1,), (len(CASSIE.motor_names),)}
    if not right_size or not (np.isfinite(values) & (values > 0)).all():
        raise ConfigurationError(
            f"limit must be a finite number above 0 [rad], or {len(CASSIE.motor_names)} of them,"
            f" got {limit!r}"
        )
    numbers = tuple(values.tolist())
    return numbers[0] if len(numbers) == 1 else numbers


class LastAction(SeededTransform):
    """Remember the previous action under `last_action`; zero, no delta, after a reset."""

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=["last_action"])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        shape = (*tensordict_reset.batch_size, len(CASSIE.motor_names))
        zeros = torch.zeros(shape, dtype=torch.float32)
        return tensordict_reset.set("last_action", zeros)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("last_action", tensordict["action"].detach())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add `last_action`."""
        return extend_spec(observation_spec, {"last_action": len(CASSIE.motor_names)})
