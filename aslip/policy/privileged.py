"""Privileged critic, which observes the truth and the dynamics of simulated robots, too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.modules import ValueOperator

from aslip.base.decorators import on_cpu_in_single
from aslip.policy.networks import PolicyShape, RunningNormalizer, Scaled, perceptron
from aslip.policy.symmetry import Symmetrised, observation_mirror
from aslip.transforms import OBSERVATION_TABLE

PRIVILEGED_SIZES: Final[Mapping[str, int]] = MappingProxyType(
    {
        "pelvis_position": 3,
        "pelvis_orientation": 4,
        "pelvis_velocity": 3,
        "left_foot_position": 3,
        "right_foot_position": 3,
    }
)
"""Entries of `true_odometry` that a privileged critic sees -> number of their elements."""

PRIVILEGED_SIGNS: Final = {
    "pelvis_position": (1.0, -1.0, 1.0),
    "pelvis_orientation": (1.0, -1.0, 1.0, -1.0),
    "pelvis_velocity": (1.0, -1.0, 1.0),
}
"""Signs of the mirror images of entries that `observation_mirror` does not know."""


def privileged_table(
    dynamics: Sequence[str], numbers: Sequence[NestedKey] = ()
) -> tuple[NestedKey, ...]:
    """Keys of the entries that a privileged critic sees in addition to the observation.

    Args:
        dynamics: parameters that `RandomDynamics` draws, by their names.
        numbers: keys of other entries (n, 1), which do not differ between a motion and its mirror
            image.
    """
    truth = [("true_odometry", name) for name in PRIVILEGED_SIZES]
    return (*truth, *(("dynamics", name) for name in dynamics), *numbers)


@on_cpu_in_single
def make_privileged_critic(
    normalizer: RunningNormalizer,
    shape: PolicyShape | None = None,
    observation: Sequence[NestedKey] = OBSERVATION_TABLE,
    *,
    dynamics: Sequence[str],
    numbers: Sequence[NestedKey] = (),
    key: NestedKey = "privileged",
    scale: float = 1.0,
) -> ValueOperator:
    """Make a value function: `observation` and privileged entries -> `state_value`.

    The critic is asymmetric (Pinto et al. 2018): it is used in training only, so it may observe
    quantities that the policy must infer. Its privileged entry has a normaliser of its own;
    `AssembleObservation(privileged_table(dynamics, numbers), out_keys=[key])` writes it.

    Args:
        normalizer: normaliser of the observation, shared with the actor.
        shape: shape of the network, as for the actor.
        observation: keys of the observation's entries, as for the actor.
        dynamics: parameters that `RandomDynamics` draws, by their names.
        numbers: as for `privileged_table`.
        key: key of the privileged entries.
        scale: factor on the network's output.
    """
    shape = shape or PolicyShape()
    table = privileged_table(dynamics, numbers)
    size = sum(PRIVILEGED_SIZES.values()) + len(dynamics) + len(numbers)
    net = perceptron(shape.observation_size + size, 1, shape.hidden)
    parts = _Normalised(normalizer, RunningNormalizer(size, key=key))
    value: nn.Module = nn.Sequential(parts, net, Scaled(scale))
    if shape.symmetric:
        # the mirror image of a parameter of the dynamics is the parameter itself
        kept = [*dynamics, *(key if isinstance(key, str) else str(key[-1]) for key in numbers)]
        signs = {**PRIVILEGED_SIGNS, **dict.fromkeys(kept, (1.0,)), **shape.mirror_signs}
        value = Symmetrised(value, observation_mirror([*observation, *table], signs))
    return ValueOperator(_Joined(value), in_keys=["observation", key])


class _Normalised(nn.Module):
    """Normalise the parts of an input separately."""

    def __init__(self, *normalizers: RunningNormalizer) -> None:
        super().__init__()
        self.normalizers = nn.ModuleList(normalizers)
        self._sizes = [len(normalizer.mean) for normalizer in normalizers]

    def forward(self, values: Tensor) -> Tensor:
        parts = zip(self.normalizers, values.split(self._sizes, dim=-1), strict=True)
        return torch.cat([normalizer(part) for normalizer, part in parts], dim=-1)


class _Joined(nn.Module):
    """Concatenate two inputs of a network."""

    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, observation: Tensor, privileged: Tensor) -> Tensor:
        return self.net(torch.cat([observation, privileged], dim=-1))
