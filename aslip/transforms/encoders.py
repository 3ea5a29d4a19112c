"""Offsets of the motor encoders, as calibration leaves them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, check_number, extend_spec, require_keys
from aslip.transforms.curriculum import difficulty_of


class EncoderOffsets(SeededTransform):
    """Draw constant offsets of each robot's motor encoders at each of its resets.

    Writes them as `motor_offset` (n, m) [rad].

    A motor at angle q reads q + b. Estimator and policy observe that reading, and so does the PD
    loop on the robot: it tracks a target t with the motor at t - b. The transform adds b to the
    readings, and takes it from the motor targets of the simulated robot, which is the same.

    Must come after `ObservationNoise`, before the estimator and before `ActionDelta`.

    Args:
        largest: largest offset [rad]; offsets are uniform from minus to plus that.
        share: probability with which a robot has offsets; else they are zero.
        in_keys: key of the motor readings (n, W, m) [rad], and, if any, of the difficulty (n, 1),
            see `aslip.transforms.Difficulty`, which scales the offsets.

    Raises:
        ConfigurationError: `largest` is negative, `share` not from 0 to 1, or there are neither one
            nor two keys to read.
    """

    num_out_keys = 1
    needs_env = "it draws offsets at resets"

    def __init__(
        self,
        largest: float = 0.01,
        *,
        share: float = 1.0,
        in_keys: Sequence[NestedKey] = (("sensors", "motor_position"),),
    ) -> None:
        super().__init__(in_keys=in_keys, out_keys=["motor_offset"])
        if not 1 <= len(in_keys) <= 2:
            raise ConfigurationError(
                f"in_keys must be those of readings and, if any, of the difficulty, got {in_keys!r}"
            )
        self.in_keys_inv, self.out_keys_inv = ["motor_target"], ["motor_target"]
        self.largest = check_number("largest", largest, 0.0, what="in rad")
        self.share = check_number("share", share, 0, 1)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = (*tensordict_reset.batch_size, len(CASSIE.motor_names))
        offset = self.largest * (2 * torch.rand(shape, generator=self.generator) - 1)
        drawn = torch.rand((*shape[:-1], 1), generator=self.generator) < self.share
        offset = offset * drawn * difficulty_of(tensordict, self.in_keys[1:])
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
        require_keys(self, observation_spec, self.in_keys[:1])
        return extend_spec(observation_spec, {self.out_keys[0]: len(CASSIE.motor_names)})
