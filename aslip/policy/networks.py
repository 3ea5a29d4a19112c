"""Actor, critic and their shared input normaliser (Sec. IV-B).

Both networks are 64-256-256-k with ReLU, symmetrised on request. The actor's output is unbounded
and its standard deviation fixed ("We choose to use fixed covariance ... the output is unbounded").
The normaliser is part of the policy, so it travels with the weights.

Functions that make an actor (`make_actor`, `aslip.policy.make_recurrent_actor`, or your own) take a
normaliser, a `PolicyShape` and the keys of the observation's entries.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import (
    AddStateIndependentNormalScale,
    InteractionType,
    TensorDictModule,
)
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.modules import (
    MLP,
    IndependentNormal,
    ProbabilisticActor,
    ValueOperator,
)

from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError
from aslip.policy.symmetry import Mirror, Symmetrised, action_mirror, check_size, observation_mirror
from aslip.transforms import OBSERVATION_TABLE
from aslip.transforms.observation import PLANNED_TABLE

# bound of normalised inputs, so that falls do not dominate
_CLIP = 10.0
_EPSILON = 1e-4
# variance below which an input counts as constant in training
_CONSTANT = 1e-8
# beginning of the names of an actor's weights
_NET = "module.0.module."
# factor on the actor's last layer, so that training starts near the reference motion
_OUTPUT_SCALE = 0.01


@dataclass(frozen=True)
class PolicyShape:
    """Settings from which a policy's network is rebuilt before its weights are read."""

    observation_size: int = 64
    """Length of `observation` ("64D input space", Sec. IV-A)."""
    action_size: int = 10
    """Length of `action` ("10D vector", Sec. IV-A)."""
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers ("2 hidden layers of 256 nodes each", Sec. IV-B)."""
    std: float = math.exp(-2)
    """Standard deviation of every action [rad]; value of the public code, not in the paper."""
    symmetric: bool = False
    """Make the policy equivariant to the left-right mirror; not in the paper."""
    mirror_signs: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """Signs of the mirror images of your own observation entries, by name, one per element; see
    `aslip.policy.observation_mirror`."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ConfigurationError: a size is not a positive integer, `std` not a positive number,
                `symmetric` not a boolean, or a mirror sign neither 1 nor -1.
        """
        sizes = (self.observation_size, self.action_size, *self.hidden)
        if not all(type(size) is int and size > 0 for size in sizes):
            raise ConfigurationError(f"sizes of a policy must be positive integers: {self}")
        number = isinstance(self.std, int | float) and not isinstance(self.std, bool)
        if not number or not 0 < self.std < math.inf:
            raise ConfigurationError(f"std must be a positive number, got {self.std!r}")
        if not isinstance(self.symmetric, bool):
            raise ConfigurationError(f"symmetric must be True or False, got {self.symmetric!r}")
        for name, signs in self.mirror_signs.items():
            if not all(sign in (1, -1) for sign in signs):
                raise ConfigurationError(f"mirror signs of {name!r} must be 1 or -1, got {signs!r}")

    @property
    def parameters(self) -> int:
        """Number of weights and biases of a multi-layer perceptron of this shape."""
        widths = (self.observation_size, *self.hidden, self.action_size)
        return sum((a + 1) * b for a, b in itertools.pairwise(widths))


class RunningNormalizer(nn.Module):
    """Normalise to zero mean and unit variance by running statistics.

    An input that was constant in training is shifted but not scaled: the weights behind it are
    untrained, so a small deviation must stay small.

    Args:
        size: length of the input.
        key: key of the input, for `update_normalizers`; None for statistics that stay.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor
    _offset: Tensor
    _scale: Tensor

    @on_cpu_in_single
    def __init__(self, size: int, key: NestedKey | None = "observation") -> None:
        super().__init__()
        self.key = key
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        # of each input: those added to a trained policy begin at zero
        self.register_buffer("count", torch.zeros(size, dtype=torch.float64))
        # derived from the statistics, so not stored in files
        self.register_buffer("_offset", torch.zeros(size), persistent=False)
        self.register_buffer("_scale", torch.ones(size), persistent=False)

    @torch.no_grad()
    def update(self, values: Tensor) -> None:
        """Add (*b, size) values to the statistics, by the parallel variance formula."""
        values = values.reshape(-1, self.mean.numel()).double()
        count = values.shape[0]
        variance, mean = torch.var_mean(values, dim=0, correction=0)
        total = self.count + count
        delta = mean - self.mean
        moment = self.variance * self.count + variance * count
        moment += delta.square() * self.count * count / total
        self.mean += delta * count / total
        self.variance.copy_(moment / total)
        self.count.copy_(total)
        self._refresh()

    def _refresh(self) -> None:
        """Derive offset and scale from the statistics."""
        self._offset.copy_(self.mean)
        scale = (self.variance + _EPSILON**2).rsqrt()
        self._scale.copy_(torch.where(self.variance < _CONSTANT, 1.0, scale))

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        """Load the statistics, and derive offset and scale from them."""
        state, name = args[0], f"{args[1]}count"
        if name in state:  # files of earlier versions have one for all inputs
            state[name] = state[name].expand_as(state[f"{args[1]}mean"])
        super()._load_from_state_dict(*args, **kwargs)
        self._refresh()

    def forward(self, values: Tensor) -> Tensor:
        """Normalise (*b, size) values.

        Raises:
            ShapeError: the last dimension is not `size`.
        """
        check_size(values, len(self._offset))
        return ((values - self._offset) * self._scale).clamp(-_CLIP, _CLIP)


def update_normalizers(nets: Iterable[nn.Module], data: TensorDictBase) -> None:
    """Add a batch to the statistics of all normalisers of some networks, once to shared ones."""
    modules = dict.fromkeys(module for net in nets for module in net.modules())
    for module in modules:
        if isinstance(module, RunningNormalizer) and module.key is not None:
            module.update(cast("Tensor", data[module.key]))


@on_cpu_in_single
def make_actor(
    normalizer: RunningNormalizer,
    shape: PolicyShape | None = None,
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
) -> ProbabilisticActor:
    """Multi-layer perceptron policy: `observation` -> `action`, with `action_log_prob`.

    Deterministic unless an exploration type asks for samples, as a collector does.

    Args:
        normalizer: shared with the critic.
        shape: sizes, standard deviation, symmetry.
        observation: keys of the observation's entries, for the mirror image of a symmetric policy.

    Raises:
        ConfigurationError: the entries of a symmetric policy do not add up to the observation.
        UnknownNameError: a symmetric policy observes an entry whose mirror image is unknown.
    """
    return _actor_of(_action_net(normalizer, shape or PolicyShape(), observation))


@on_cpu_in_single
def make_planned_actor(
    normalizer: RunningNormalizer,
    shape: PolicyShape | None = None,
    observation: Sequence[NestedKey] = PLANNED_TABLE,
) -> ProbabilisticActor:
    """Policy of two perceptrons, for robots that follow a plan and for those that follow gaits.

    Only the first one learns. The second is that of the policy from which a training starts, see
    `planned_weights`, so that robots without a plan walk as they did.

    Args:
        normalizer: of the first one, shared with the critic.
        shape: sizes, standard deviation, symmetry, of each.
        observation: keys of the observation's entries, the last of which is `("plan", "step")`, see
            `aslip.transforms.planned.PLAN_SIZES`.

    Raises:
        ConfigurationError: it is not the last one; or as for `make_actor`.
        UnknownNameError: see `make_actor`.
    """
    if entry_names(observation)[-1:] != ["plan/step"]:
        raise ConfigurationError(
            "the observation of a policy for plans ends with ('plan', 'step'), got"
            f" {entry_names(observation)}"
        )
    shape = shape or PolicyShape()
    kept = RunningNormalizer(shape.observation_size, key=None)
    nets = (_action_net(each, shape, observation) for each in (normalizer, kept))
    return _actor_of(_OfPlans(*nets))


def planned_weights(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights of `make_planned_actor`, both of whose networks are copies of one of `make_actor`."""
    return {
        f"{_NET}{part}.{name.removeprefix(_NET)}": value
        for part in ("plans", "gaits")
        for name, value in weights.items()
    }


class _OfPlans(nn.Module):
    """Mean of one network where the observation's last number is not zero, elsewhere of another.

    The other one does not learn. The scale is that of the first one.
    """

    def __init__(self, plans: nn.Module, gaits: nn.Module) -> None:
        super().__init__()
        self.plans, self.gaits = plans, gaits

    def forward(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and scale (*b, 10) for observations (*b, k)."""
        loc, scale = self.plans(values)
        with torch.no_grad():
            other, _ = self.gaits(values)
        return torch.where(values[..., -1:] != 0, loc, other), scale


def _action_net(
    normalizer: RunningNormalizer, shape: PolicyShape, observation: Sequence[NestedKey]
) -> nn.Sequential:
    """Network of `make_actor`: mean action and standard deviation."""
    layers: list[nn.Module] = [normalizer, action_layers(shape, shape.observation_size)]
    if shape.symmetric:
        mirrors = _mirror_of(shape, observation), action_mirror()
        layers = [Symmetrised(nn.Sequential(*layers), *mirrors)]
    return nn.Sequential(*layers, action_scale(shape))


def _actor_of(net: nn.Module) -> ProbabilisticActor:
    return gaussian_actor(TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]))


def perceptron(inputs: int, outputs: int, hidden: Sequence[int]) -> MLP:
    """Multi-layer perceptron with rectified linear units and hidden layers of some widths."""
    return MLP(inputs, outputs, num_cells=list(hidden), activation_class=nn.ReLU)


@on_cpu_in_single
def action_layers(shape: PolicyShape, inputs: int, hidden: Sequence[int] | None = None) -> MLP:
    """Multi-layer perceptron whose output, the mean action, is small before training.

    Args:
        shape: sizes.
        inputs: number of inputs.
        hidden: widths of the hidden layers; those of the shape by default.
    """
    net = perceptron(inputs, shape.action_size, shape.hidden if hidden is None else hidden)
    output = net[-1]
    assert isinstance(output, nn.Linear)
    with torch.no_grad():
        output.weight.mul_(_OUTPUT_SCALE)
        output.bias.zero_()
    return net


@on_cpu_in_single
def action_scale(shape: PolicyShape) -> AddStateIndependentNormalScale:
    """Layer that adds the standard deviation, which `set_std` changes, to the mean action."""
    return AddStateIndependentNormalScale(
        shape.action_size, scale_mapping="exp", make_param=False, init_value=math.log(shape.std)
    )


@on_cpu_in_single
def gaussian_actor(module: TensorDictModule) -> ProbabilisticActor:
    """Policy that draws `action` around `loc` with the standard deviation `scale`.

    Args:
        module: writes `loc` and `scale`.
    """
    return ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        out_keys=["action"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
        default_interaction_type=InteractionType.DETERMINISTIC,
    )


def set_std(actor: nn.Module, std: float) -> None:
    """Set the standard deviation of all actions [rad]; no effect on networks that learn it."""
    for module in actor.modules():
        if isinstance(module, AddStateIndependentNormalScale):
            with torch.no_grad():
                module.state_independent_scale.fill_(math.log(std))


@on_cpu_in_single
def make_critic(
    normalizer: RunningNormalizer,
    shape: PolicyShape | None = None,
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
    *,
    scale: float = 1.0,
) -> ValueOperator:
    """Value function: `observation` -> `state_value`.

    Args:
        normalizer: shared with the actor.
        shape: as the actor's.
        observation: as the actor's.
        scale: factor on the network's output; the magnitude of the returns makes learning faster.
    """
    shape = shape or PolicyShape()
    net = perceptron(shape.observation_size, 1, shape.hidden)
    value: nn.Module = nn.Sequential(normalizer, net, Scaled(scale))
    if shape.symmetric:
        value = Symmetrised(value, _mirror_of(shape, observation))
    return ValueOperator(value, in_keys=["observation"])


def _mirror_of(shape: PolicyShape, observation: Sequence[NestedKey]) -> Mirror:
    mirror = observation_mirror(observation, shape.mirror_signs)
    if len(mirror.index) != shape.observation_size:
        raise ConfigurationError(
            f"the mirror images of {entry_names(observation)} have {len(mirror.index)} numbers, the"
            f" observation has {shape.observation_size}; train without symmetry (--no-symmetric)"
        )
    return mirror


class Scaled(nn.Module):
    """Multiply by a constant factor."""

    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor

    def forward(self, values: Tensor) -> Tensor:
        """Values of any shape times the factor."""
        return self.factor * values


def entry_names(table: Iterable[NestedKey]) -> list[str]:
    """Names of an observation's entries, as written in a policy's card: "estimate/height"."""
    keys = [unravel_key(key) for key in table]
    return [key if isinstance(key, str) else "/".join(map(str, key)) for key in keys]
