"""Reward terms, one transform each, and their weighted sum (Sec. IV-B)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.base.checks import check_number
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.transforms.base import SeededTransform, extend_spec

TermFunction = Callable[..., Tensor]


class RewardTerm(SeededTransform):
    """Write one named term of the reward, computed by a pure function.

    The term is `("reward_terms", name)` (n, 1), zero after a reset and for robots whose simulation
    diverged in the step, or, without simulation, that have stopped. The functions of the paper's
    terms are in `aslip.transforms.rewards`. A step raises `ShapeError` if the function does not
    return one number per robot.

    Write a term with memory, such as the time since a foot last touched the ground, as a
    `SeededTransform` of its own: write the memory and `("reward_terms", name)` in `_step` and
    `_reset`, and declare both in `transform_observation_spec`. Terms are in the observation spec
    because TorchRL takes each entry of the reward spec for a reward, and many of its transforms
    accept only one.

    Args:
        name: name of the term.
        function: tensors (*b, k) in the order of the keys -> (*b, 1).
        next_keys: entries after the step that the function reads.
        root_keys: entries before the step, and the action, that it reads; these come last.
            `("target", ...)` is the reference to be reached by this step, see `ReferenceInjection`.
    """

    def __init__(
        self,
        name: str,
        function: TermFunction,
        next_keys: Sequence[NestedKey],
        root_keys: Sequence[NestedKey] = (),
    ) -> None:
        if not (isinstance(name, str) and name and callable(function)):
            raise ConfigurationError(
                f"a reward term needs a name and a function, got {name!r} and {function!r}"
            )
        if isinstance(next_keys, str) or isinstance(root_keys, str) or not [*next_keys, *root_keys]:
            raise ConfigurationError(
                f"the reward term {name!r} needs lists of the entries that it reads, next_keys or"
                f" root_keys, got {next_keys!r} and {root_keys!r}"
            )
        super().__init__(in_keys=[*next_keys, *root_keys], out_keys=[("reward_terms", name)])
        self.function = function
        self.next_keys = tuple(next_keys)
        self.root_keys = tuple(root_keys)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        inputs = [next_tensordict[key] for key in self.next_keys]
        inputs += [tensordict[key].detach() for key in self.root_keys]
        value, expected = self.function(*inputs), (*next_tensordict.batch_size, 1)
        if value.shape != expected:
            raise ShapeError(
                f"the reward term {self.out_keys[0][-1]!r} must have shape {expected}, one number a"
                f" robot, got {tuple(value.shape)}; reduce with dim=-1, keepdim=True"
            )
        # a non-finite action makes a robot diverge, and must not make the reward non-finite
        lost = next_tensordict.get(("truth", "diverged"), next_tensordict.get("terminated", None))
        value = value.float() if lost is None else torch.where(lost, 0.0, value.float())
        return next_tensordict.set(self.out_keys[0], value)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        zeros = torch.zeros(*tensordict_reset.batch_size, 1, dtype=torch.float32)
        return tensordict_reset.set(self.out_keys[0], zeros)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the term."""
        return extend_spec(observation_spec, {self.out_keys[0]: 1})


class WeightedReward(SeededTransform):
    """Write the reward, the weighted sum of the terms in the stack.

    A term left out of the stack contributes nothing; a term of weight zero is still logged. A
    penalty is a term with a negative weight.

    Args:
        weights: name of a term -> weight.

    Raises:
        ConfigurationError: a weight is not finite.
        UnknownNameError: the stack has no terms, or one has no weight (raised when added to it).
    """

    def __init__(self, weights: Mapping[str, float]) -> None:
        super().__init__(in_keys=["reward_terms"], out_keys=["reward"])
        if not isinstance(weights, Mapping) or not weights:
            raise ConfigurationError(
                f"weights must map names of terms to weights, at least one, got {weights!r}"
            )
        self.weights = {
            name: check_number(f"the weight of {name!r}", weight)
            for name, weight in weights.items()
        }

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        reward = torch.zeros(*next_tensordict.batch_size, 1, dtype=torch.float32)
        for name, term in next_tensordict[self.in_keys[0]].items():
            reward = reward + self.weights[name] * term
        return next_tensordict.set(self.out_keys[0], reward)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Check that every term has a weight."""
        terms = observation_spec.get(self.in_keys[0], None)
        if terms is None:
            raise UnknownNameError(
                "WeightedReward finds no reward terms; the stack must have some, before it"
            )
        missing = sorted(set(terms.keys()) - set(self.weights))
        if missing:
            raise UnknownNameError(
                f"no weight for the reward terms {missing}; weights are given for"
                f" {sorted(self.weights)}"
            )
        return observation_spec


class EpisodeSum(SeededTransform):
    """Sum the rewards since the reset.

    It does what TorchRL's `RewardSum` does, but making an environment takes half as long:
    `RewardSum` computes the specs of the whole stack twice to find the shape of a reward.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=["reward"], out_keys=["episode_reward"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        total = tensordict.get(self.out_keys[0], 0.0) + next_tensordict[self.in_keys[0]]
        return next_tensordict.set(self.out_keys[0], total)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        zeros = torch.zeros(*tensordict_reset.batch_size, 1, dtype=torch.float32)
        return tensordict_reset.set(self.out_keys[0], zeros)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the sum."""
        return extend_spec(observation_spec, {self.out_keys[0]: 1})
