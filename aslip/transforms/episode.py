"""When an episode begins, and when it is over."""

from __future__ import annotations

from numbers import Integral

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, check_number


class FirstStep(SeededTransform):
    """Write whether the coming step is the first of its episode, `is_init` (n, 1) bool.

    Recurrent policies forget by it, and TorchRL's collectors ask for it whatever the policy. As
    TorchRL's `InitTracker`, without asking for the specs of the whole stack.
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
        # TorchRL takes only the rows of robots that are reset
        return self._write(tensordict_reset, True)

    def _write(self, tensordict: TensorDictBase, first: bool) -> TensorDictBase:
        return tensordict.set("is_init", torch.full((*tensordict.batch_size, 1), first))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the flag."""
        shape = torch.Size((*observation_spec.shape, 1))
        observation_spec["is_init"] = Binary(shape=shape, dtype=torch.bool)
        return observation_spec


class _Termination(SeededTransform):
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

    Raises:
        ConfigurationError: the threshold is no finite number.
    """

    def __init__(self, threshold: float = 0.3) -> None:
        super().__init__(["reward"])
        self.threshold = check_number("threshold", threshold)

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

    Raises:
        ConfigurationError: the height is no finite number.
    """

    def __init__(self, height: float = CASSIE.fall_height) -> None:
        super().__init__([("truth", "pelvis_position")])
        self.height = check_number("height", height, what="of the pelvis [m]")

    def _over(self, value: Tensor) -> Tensor:
        return value[..., 2:] < self.height


class StaggeredEnds(SeededTransform):
    """End the first episodes of robots at different times, or those that never fall stay in step.

    When all robots are reset at once, each draws from 1 to `max_steps` policy steps after which its
    episode is truncated. Episodes after that are as long as the rest of the stack lets them be.
    TorchRL's `RandomTruncationTransform` does so, too, but neither follows `env.set_seed` nor
    travels in the tensordict, as resuming bit for bit needs.

    `stagger` (n, 1) counts the steps that are left, and is 0 where no end is set: in a step with 1
    the episode is cut short. Must come after the `StepCounter`.

    Args:
        max_steps: longest first episode [policy steps].

    Raises:
        ConfigurationError: `max_steps` is no whole number of 1 or more.
    """

    def __init__(self, max_steps: int) -> None:
        super().__init__(in_keys=["truncated", "done"], out_keys=["truncated", "done", "stagger"])
        if not isinstance(max_steps, Integral) or isinstance(max_steps, bool) or max_steps < 1:
            raise ConfigurationError(
                f"max_steps must be a whole number of 1 or more, got {max_steps!r}"
            )
        self.max_steps = int(max_steps)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = (*tensordict_reset.batch_size, 1)
        left = torch.zeros(shape, dtype=torch.int64)
        if tensordict.get("_reset", None) is None:
            left = torch.randint(1, self.max_steps + 1, shape, generator=self.generator)
        return tensordict_reset.set("stagger", left)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        left = torch.as_tensor(tensordict["stagger"])
        for key in self.in_keys:
            next_tensordict.set(key, torch.as_tensor(next_tensordict[key]) | (left == 1))
        return next_tensordict.set("stagger", (left - 1).clamp(min=0))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the steps left."""
        shape = torch.Size((*observation_spec.shape, 1))
        observation_spec["stagger"] = Unbounded(shape, dtype=torch.int64)
        return observation_spec
