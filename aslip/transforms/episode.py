"""When an episode is over."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from aslip.task import FALL_HEIGHT
from aslip.transforms.base import CassieTransform


class _Termination(CassieTransform):
    """End an episode, without bootstrap, where a condition holds after a step."""

    def __init__(self, in_keys: list) -> None:
        super().__init__(in_keys=in_keys, out_keys=["terminated", "done"])

    def _over(self, value: Tensor) -> Tensor:
        """(*b, 1) bool of the value under the first key."""
        raise NotImplementedError

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        over = self._over(next_tensordict[self.in_keys[0]])
        for key in self.out_keys:
            next_tensordict.set(key, torch.as_tensor(next_tensordict[key] | over))
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return tensordict_reset


class LowReward(_Termination):
    """End an episode when the reward of a step is below a threshold.

    With terms left out the largest possible reward shrinks, the threshold does not: give another
    one along with other weights.

    Args:
        threshold: "less than 0.3" in the paper (Sec. IV-B).
    """

    def __init__(self, threshold: float = 0.3) -> None:
        super().__init__(["reward"])
        self.threshold = threshold

    def _over(self, value: Tensor) -> Tensor:
        # a reward that is not a number is low, too
        return ~(value >= self.threshold)


class Fall(_Termination):
    """End an episode when the pelvis is too low.

    Paper: the reward threshold "encapsulates when the robot falls to the ground", and no height is
    given. Public code ends below 0.4 m as well. We do, so that ablations of the reward do not
    learn from robots on the floor; with the full reward the threshold acts first.

    Args:
        height: of the pelvis above the floor [m].
    """

    def __init__(self, height: float = FALL_HEIGHT) -> None:
        super().__init__([("truth", "pelvis_position")])
        self.height = height

    def _over(self, value: Tensor) -> Tensor:
        return value[..., 2:] < self.height
