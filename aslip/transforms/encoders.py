"""Offsets of the motor encoders, as calibration leaves them."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.base.checks import check_number
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, extend_spec, require_keys
from aslip.transforms.curriculum import difficulty_of


class EncoderOffsets(SeededTransform):
    """Draw constant offsets of each robot's motor encoders at each of its resets.

    Writes them as `motor_offset` (n, m) [rad].

    A motor at angle q reads q + b. Estimator and policy observe that reading, and so does the PD
    loop on the robot: it tracks a target t with the motor at t - b. The transform adds b to the
    readings, and subtracts it from the motor targets of the simulated robot, which is equivalent.

    Must come after `ObservationNoise`, before the estimator and before `ActionDelta`.

    Args:
        largest: largest offset [rad]; offsets are uniform from minus to plus that.
        share: probability with which a robot has offsets; else they are zero.
        difficulty_key: key of the difficulty (n, 1) that scales the offsets, see
            `aslip.transforms.Difficulty`.

    Raises:
        ConfigurationError: `largest` is negative, or `share` not from 0 to 1.
    """

    needs_env = "it draws offsets at resets"

    def __init__(
        self,
        largest: float = 0.01,
        *,
        share: float = 1.0,
        difficulty_key: NestedKey | None = None,
    ) -> None:
        super().__init__([("sensors", "motor_position")], ["motor_offset"])
        self.difficulty_key = difficulty_key
        self.in_keys_inv, self.out_keys_inv = ["motor_target"], ["motor_target"]
        self.largest = check_number("largest", largest, 0.0, what="in rad")
        self.share = check_number("share", share, 0, 1)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = (*tensordict_reset.batch_size, len(CASSIE.motor_names))
        offset = self.largest * (2 * torch.rand(shape, generator=self.generator) - 1)
        drawn = torch.rand((*shape[:-1], 1), generator=self.generator) < self.share
        offset = offset * drawn * difficulty_of(tensordict, self.difficulty_key)
        return self._read(tensordict_reset, offset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._read(next_tensordict, cast("Tensor", tensordict[self.out_keys[0]]))

    def _read(self, into: TensorDictBase, offset: Tensor) -> TensorDictBase:
        """Add the offset to the readings."""
        readings = cast("Tensor", into[self.in_keys[0]])
        into.set(self.in_keys[0], readings + offset.unsqueeze(-2))
        return into.set(self.out_keys[0], offset)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (key,) = self.in_keys_inv
        return tensordict.set(key, tensordict[key] - tensordict[self.out_keys[0]])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the offsets."""
        require_keys(self, observation_spec, self.in_keys)
        return extend_spec(observation_spec, {self.out_keys[0]: len(CASSIE.motor_names)})
