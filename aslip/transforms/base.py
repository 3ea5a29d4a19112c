"""What our transforms share: one place to compute, called on steps and at resets alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from aslip.errors import ConfigurationError, ShapeError, UnknownNameError


class SeededTransform(Transform):
    """A transform whose `_call` also runs at resets, and that can be seeded.

    TorchRL runs `_call` on steps only; a key it writes would be missing after a reset.
    """

    def __init__(self, in_keys: list[NestedKey], out_keys: Sequence[NestedKey]) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self.generator = torch.Generator()
        self.set_seed(0)

    def set_seed(self, seed: int) -> None:
        """Restart the transform's own random numbers."""
        self.generator.manual_seed(seed)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return self._call(tensordict_reset)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        """Write into the specs, which are the environment's copy already.

        TorchRL's own copies the specs of all keys once more for each transform.

        Raises:
            UnknownNameError: `transform_observation_spec` and its like leave out a key of
                `out_keys`.
        """
        specs = self._transform_specs(output_spec, ("observation", "reward", "done"))
        for key in self.out_keys:
            if all(spec.get(key, None) is None for spec in specs):
                raise UnknownNameError(
                    f"{type(self).__name__} writes {key!r}, which its specs leave out; add it in"
                    " transform_observation_spec"
                )
        return output_spec

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Write into the specs, which are the environment's copy already."""
        self._transform_specs(input_spec, ("state", "action"))
        return input_spec

    def _transform_specs(self, spec: Composite, kinds: Sequence[str]) -> list[Composite]:
        for kind in kinds:
            key = f"full_{kind}_spec"
            spec[key] = getattr(self, f"transform_{kind}_spec")(spec[key])
        return [spec[f"full_{kind}_spec"] for kind in kinds]

    def _draw_into_reset(
        self, tensordict: TensorDictBase, key: NestedKey, draw: torch.Tensor
    ) -> TensorDictBase:
        """Put `draw` into the request for a reset, unless the caller chose a value.

        A request that names robots to reset is a tensordict of the episode that ends; what it
        holds is old, not chosen.
        """
        if tensordict.get(key, None) is None or "_reset" in tensordict:
            tensordict.set(key, draw)
        return tensordict

    def _request(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        """The request for a reset; an empty one when all is to be reset to whatever is drawn."""
        if tensordict is not None:
            return tensordict
        # slow, TorchRL builds the environment below anew: StackEnv never comes here
        parent = self.parent
        if parent is None:
            raise RuntimeError(f"{type(self).__name__} needs an environment; add it to one first")
        return TensorDict(batch_size=parent.batch_size)


def check_number(
    name: str, value: Any, low: float = -math.inf, high: float = math.inf, what: str = ""
) -> float:
    """A setting as a float, if it is a finite number from `low` to `high`.

    Args:
        name: of the setting, for the message.
        value: what was given.
        low: least value.
        high: greatest value.
        what: meaning and unit, for the message.

    Raises:
        ConfigurationError: it is not.
    """
    real = isinstance(value, Real) and not isinstance(value, bool)
    number = float(value) if real else math.nan
    if not math.isfinite(number) or not low <= number <= high:
        limits = [f"of at least {low:g}"] * (low > -math.inf) + [f"of at most {high:g}"] * (
            high < math.inf
        )
        told = " ".join(["a finite number", " and ".join(limits)]).strip()
        meaning = f" ({what})" if what else ""
        raise ConfigurationError(f"{name} must be {told}{meaning}, got {value!r}")
    return number


def extend_spec(spec: Composite, sizes: Mapping[Any, int]) -> Composite:
    """Add unbounded single-precision leaves of the given last dimensions to a spec."""
    for key, size in sizes.items():
        spec[key] = Unbounded(torch.Size((*spec.shape, size)), dtype=torch.float32)
    return spec


def require_keys(transform: Transform, spec: TensorSpec, keys: Sequence[NestedKey]) -> None:
    """Check that a spec has all that a transform reads.

    Raises:
        UnknownNameError: a key is missing; the message lists the keys there are.
    """
    assert isinstance(spec, Composite)
    available = set(spec.keys(True, True))
    for key in keys:
        if key not in available:
            names = sorted("/".join(k) if isinstance(k, tuple) else k for k in available)
            raise UnknownNameError(
                f"{type(transform).__name__} reads {key!r}, which nothing before it in the stack"
                f" writes; there are {names}"
            )


def checked_column(tensordict: TensorDictBase, key: str) -> torch.Tensor:
    """A value that a caller may have written, in single precision.

    Raises:
        ShapeError: it has not one number a robot.
        ConfigurationError: a number is not finite.
    """
    value = torch.as_tensor(tensordict[key])
    expected = (*tensordict.batch_size, 1)
    if tuple(value.shape) != expected:
        raise ShapeError(f"{key} must have shape {expected}, got {tuple(value.shape)}")
    if not torch.isfinite(value).all():
        raise ConfigurationError(f"{key} must be finite, got {value.tolist()}")
    return value.float()
