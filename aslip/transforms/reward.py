"""Rewards: one transform a term, and their weighted sum (Sec. IV-B)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.transforms.base import SeededTransform, check_number, extend_spec

TermFunction = Callable[..., Tensor]


class RewardTerm(SeededTransform):
    """One named term of the reward, computed by a pure function; see `aslip.transforms.rewards`.

    TorchRL counts terms among the observations: what is in the specs of rewards are rewards to its
    transforms, and many take one only.

    Args:
        name: the term is written under `("reward_terms", name)` (*b, 1); zero after a reset.
        function: tensors (*b, k) in the order of the keys -> (*b, 1) in [0, 1].
        next_keys: what it reads of the state after the step.
        root_keys: what it reads of the state before the step and of the action; these come last.
            `("goal", ...)` is the reference to be reached by this step, see `ReferenceInjection`.

    A step raises `ShapeError` if the function does not give one number a robot.
    """

    def __init__(
        self,
        name: str,
        function: TermFunction,
        next_keys: Sequence[NestedKey],
        root_keys: Sequence[NestedKey] = (),
    ) -> None:
        if not isinstance(name, str) or not name:
            raise ConfigurationError(f"name must be a string that is not empty, got {name!r}")
        if not callable(function):
            raise ConfigurationError(f"function of {name!r} must be callable, got {function!r}")
        for which, keys in (("next_keys", next_keys), ("root_keys", root_keys)):
            if isinstance(keys, str) or not isinstance(keys, Sequence):
                raise ConfigurationError(f"{which} of {name!r} must be a list, got {keys!r}")
        if not [*next_keys, *root_keys]:
            raise ConfigurationError(
                f"the term {name!r} reads nothing; give next_keys or root_keys"
            )
        super().__init__(in_keys=[*next_keys, *root_keys], out_keys=[("reward_terms", name)])
        self.function = function
        self.next_keys = tuple(next_keys)
        self.root_keys = tuple(root_keys)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        inputs = [next_tensordict[key] for key in self.next_keys]
        inputs += [tensordict[key].detach() for key in self.root_keys]
        # a robot that diverged was put back on its feet, for which it deserves nothing; and what
        # made it diverge, an action that is no number, must not become a reward
        diverged = next_tensordict.get(("truth", "diverged"), None)
        if diverged is None:
            # a robot that is no simulation
            diverged = next_tensordict["terminated"]
        value = self.function(*inputs)
        if value.shape != diverged.shape:
            raise ShapeError(
                f"the reward term {self.out_keys[0][-1]!r} must have shape {tuple(diverged.shape)},"
                f" one number a robot, got {tuple(value.shape)}; reduce with dim=-1, keepdim=True"
            )
        value = torch.where(diverged, 0.0, value.float())
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
    """The reward: weighted sum of the terms there are.

    A term left out of the stack contributes nothing; a term of weight zero is still logged.

    Args:
        weights: name of a term -> weight.

    Raises:
        ConfigurationError: a weight is negative or not finite.
        UnknownNameError: there are no terms, or one has no weight (raised when added to a stack).
    """

    def __init__(self, weights: Mapping[str, float]) -> None:
        super().__init__(in_keys=["reward_terms"], out_keys=["reward"])
        if not isinstance(weights, Mapping) or not weights:
            raise ConfigurationError(
                f"weights must map names of terms to weights, at least one, got {weights!r}"
            )
        penalty = "a penalty is a term that falls from one to zero, such as exp(-cost)"
        self.weights = {
            name: check_number(f"the weight of {name!r}", weight, low=0, what=penalty)
            for name, weight in weights.items()
        }

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        reward = torch.zeros(*next_tensordict.batch_size, 1, dtype=torch.float32)
        for name, term in next_tensordict["reward_terms"].items():
            reward = reward + self.weights[name] * term
        return next_tensordict.set("reward", reward)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Check that every term has a weight."""
        if "reward_terms" not in observation_spec:
            raise UnknownNameError(
                "WeightedReward finds no reward terms; the stack must have some, before it"
            )
        missing = sorted(set(observation_spec["reward_terms"].keys()) - set(self.weights))
        if missing:
            raise UnknownNameError(
                f"no weight for the reward terms {missing}; weights are given for"
                f" {sorted(self.weights)}"
            )
        return observation_spec


class EpisodeSum(SeededTransform):
    """Sum of the rewards since the reset, `reward` -> `episode_reward` (n, 1).

    As TorchRL's `RewardSum`, which computes the specs of the whole stack again, twice, to find the
    shape of a reward: half the time it takes to make an environment.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=["reward"], out_keys=["episode_reward"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        total = tensordict.get("episode_reward", 0.0) + next_tensordict["reward"]
        return next_tensordict.set("episode_reward", total)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        zeros = torch.zeros(*tensordict_reset.batch_size, 1, dtype=torch.float32)
        return tensordict_reset.set("episode_reward", zeros)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the sum."""
        return extend_spec(observation_spec, {"episode_reward": 1})
