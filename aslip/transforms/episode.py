"""Begin and end of episodes."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded

from aslip.base.checks import check_count, check_number
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform


class FirstStep(SeededTransform):
    """Mark the first step of each episode, `is_init` (n, 1) bool.

    Recurrent policies reset their hidden state by it, and TorchRL's collectors require it for any
    policy. It does what TorchRL's `InitTracker` does, but is faster to add to an environment:
    `InitTracker` computes the specs of the whole stack again.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=["is_init"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        return self._write(next_tensordict, False)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        # TorchRL uses only the rows of reset robots
        return self._write(tensordict_reset, True)

    def _write(self, tensordict: TensorDictBase, first: bool) -> TensorDictBase:
        return tensordict.set(self.out_keys[0], torch.full((*tensordict.batch_size, 1), first))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the flag."""
        shape = torch.Size((*observation_spec.shape, 1))
        observation_spec[self.out_keys[0]] = Binary(shape=shape, dtype=torch.bool)
        return observation_spec


class _Termination(SeededTransform):
    """Terminate an episode, so that no value is bootstrapped, if a condition holds after a step."""

    def __init__(self, *keys: NestedKey) -> None:
        super().__init__(in_keys=list(keys), out_keys=["terminated", "done"])

    def _over(self, *values: Tensor) -> Tensor:
        """Flag (*b, 1) bool of episodes that end with these values."""
        raise NotImplementedError

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        over = self._over(*(cast("Tensor", next_tensordict[key]) for key in self.in_keys))
        for key in self.out_keys:
            next_tensordict.set(key, torch.as_tensor(next_tensordict[key] | over))
        return next_tensordict


class LowReward(_Termination):
    """Terminate an episode when the reward of a step is below a threshold.

    The threshold does not adapt to the weights: leaving reward terms out lowers the largest
    possible reward, so choose a new threshold together with new weights.

    Args:
        threshold: least reward with which an episode continues; in the paper, a reward "less than
            0.3" ends it (Sec. IV-B).

    Raises:
        ConfigurationError: `threshold` is not a finite number.
    """

    def __init__(self, threshold: float = 0.3) -> None:
        super().__init__("reward")
        self.threshold = check_number("threshold", threshold)

    def _over(self, *values: Tensor) -> Tensor:
        # NaN counts as low
        return ~(values[0] >= self.threshold)


class Fall(_Termination):
    """Terminate an episode when the pelvis is too low.

    The paper gives no height: its reward threshold "encapsulates when the robot falls to the
    ground". The public code also ends episodes below 0.4 m. We do so too, so that ablations of the
    reward do not learn from robots on the floor; with the full reward the threshold acts first.

    Args:
        height: least height of the pelvis above the floor, or the stones below the feet [m].

    Raises:
        ConfigurationError: `height` is not a finite number.
    """

    def __init__(self, height: float = CASSIE.fall_height) -> None:
        super().__init__(("truth", "pelvis_position"), ("truth", "ground_height"))
        self.height = check_number("height", height, what="of the pelvis [m]")

    def _over(self, *values: Tensor) -> Tensor:
        position, ground = values
        return position[..., 2:] - ground < self.height


class StaggeredEnds(SeededTransform):
    """Truncate the first episodes at random times, so that robots do not reset all at once.

    A reset of all robots draws for each the policy step, from 1 to `max_steps`, after which its
    episode is truncated. Later episodes are not affected. TorchRL's `RandomTruncationTransform`
    does the same, but neither follows `env.set_seed` nor keeps its count in the tensordict; bitwise
    resuming needs both.

    `stagger` (n, 1) counts the remaining steps down: the step that starts with 1 is truncated, and
    0 means that no truncation is due. Must come after the `StepCounter`.

    Args:
        max_steps: length of the longest first episode [policy steps].

    Raises:
        ConfigurationError: `max_steps` is not a whole number of 1 or more.
    """

    needs_env = "it draws the lengths of episodes at resets"

    def __init__(self, max_steps: int) -> None:
        super().__init__(in_keys=["truncated", "done"], out_keys=["stagger"])
        self.max_steps = check_count("max_steps", max_steps)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = (*tensordict_reset.batch_size, 1)
        left = torch.zeros(shape, dtype=torch.int64)
        if tensordict.get("_reset", None) is None:
            left = torch.randint(1, self.max_steps + 1, shape, generator=self.generator)
        return tensordict_reset.set(self.out_keys[0], left)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        left = torch.as_tensor(tensordict[self.out_keys[0]])
        for key in self.in_keys:
            next_tensordict.set(key, torch.as_tensor(next_tensordict[key]) | (left == 1))
        return next_tensordict.set(self.out_keys[0], (left - 1).clamp(min=0))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the count."""
        shape = torch.Size((*observation_spec.shape, 1))
        observation_spec[self.out_keys[0]] = Unbounded(shape, dtype=torch.int64)
        return observation_spec
