"""Base class of the transforms, and checks of their settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, ClassVar, Self, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import CASSIE


class SeededTransform(Transform):
    """Base class of transforms that act at steps and resets and are seeded by `env.set_seed`.

    Override `_call` to compute entries from others of the same time: TorchRL runs it at steps only,
    this class also at resets. Override `_step` and `_reset` to compute entries from those of the
    previous step. Keep the state of an episode in the tensordict, not in the transform; then
    partial resets, worker processes and replay just work.

    Until it is seeded, each transform draws numbers of its own. `make_env` adds a copy to each
    environment: lists, dicts and tensors of the transform are its own, other objects are shared,
    such as gait libraries and networks.

    Without an environment, as in a replay buffer or a model, `transform(tensordict)` applies
    `_call` to the tensordict, or `_step` to the tensordict and its `"next"`.

    Args:
        in_keys: entries that the transform reads.
        out_keys: entries that the transform writes.
    """

    place = torch.device("cpu")
    """Device of the entries."""
    needs_env: ClassVar[str] = ""
    """Reason why the class acts in environments only; empty if it does not."""

    @on_cpu_in_single
    def __init__(self, in_keys: Sequence[NestedKey], out_keys: Sequence[NestedKey]) -> None:
        super().__init__(
            *([keys] if isinstance(keys, str) else list(keys) for keys in (in_keys, out_keys))
        )
        self.generator = torch.Generator()
        self.set_seed(self.generator.seed())

    @on_cpu_in_single
    def clone(self) -> Self:
        """Copy without an environment, with random numbers of its own."""
        copied = super().clone()
        copied.generator = torch.Generator(self.place)
        copied.set_seed(copied.generator.seed())
        return copied

    @on_cpu_in_single
    def set_seed(self, seed: int) -> None:
        """Restart the transform's own random numbers."""
        self.generator.manual_seed(seed)

    def move(self, place: torch.device) -> None:
        """Act on another device from now on, with random numbers of its own."""
        self.place = place
        self.generator = torch.Generator(place)
        self.set_seed(self.generator.seed())

    @on_cpu_in_single
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Act on a tensordict without an environment.

        Raises:
            NotImplementedError: the transform acts in environments only; the message says why.
        """
        if self.needs_env:
            raise NotImplementedError(
                f"{type(self).__name__} acts in an environment only: {self.needs_env}"
            )
        if type(self)._step is Transform._step:
            return self._call(tensordict)
        following = cast("TensorDictBase", tensordict["next"])
        return tensordict.set("next", self._step(tensordict, following))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return self._call(tensordict_reset)

    @on_cpu_in_single
    def transform_output_spec(self, output_spec: Composite) -> Composite:
        """Write into the specs, which are already a copy of the environment's.

        TorchRL's method copies the specs of all keys again for each transform.

        Raises:
            UnknownNameError: a key of `out_keys` is in no spec: `transform_observation_spec`, or
                the method of another spec, does not add it.
        """
        specs = self._transform_specs(output_spec, ("observation", "reward", "done"))
        for key in self.out_keys:
            if all(spec.get(key, None) is None for spec in specs):
                raise UnknownNameError(
                    f"{type(self).__name__} writes {key!r}, but its specs lack it; add it in"
                    " transform_observation_spec"
                )
        return output_spec

    @on_cpu_in_single
    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Write into the specs, which are already a copy of the environment's."""
        self._transform_specs(input_spec, ("state", "action"))
        return input_spec

    def _transform_specs(self, spec: Composite, kinds: Sequence[str]) -> list[Composite]:
        for kind in kinds:
            key = f"full_{kind}_spec"
            spec[key] = getattr(self, f"transform_{kind}_spec")(spec[key])
        return [spec[f"full_{kind}_spec"] for kind in kinds]

    def _request(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        """Request for a reset; if the caller made none, an empty one, which chooses no values."""
        if tensordict is not None:
            return tensordict
        # slow: TorchRL rebuilds the base environment (StackEnv always passes a request)
        parent = self.parent
        if parent is None:
            raise RuntimeError(f"{type(self).__name__} needs an environment; add it to one first")
        return TensorDict(batch_size=parent.batch_size)


class ChosenAtReset(SeededTransform):
    """Base class of transforms that draw entries at resets, unless a caller chooses them.

    A caller chooses an entry by passing it to the reset, or by writing it between steps. TorchRL
    prepares resets from the last transform of a stack to the first, so that a transform finds the
    entries of later ones in the request. A subclass implements `_drawn` and `_step`.

    Args:
        in_keys: entries that the transform reads.
        sizes: entry (n, k) that it writes -> k.
    """

    def __init__(self, in_keys: Sequence[NestedKey], sizes: Mapping[NestedKey, int]) -> None:
        super().__init__(in_keys, list(sizes))
        self._sizes = dict(sizes)

    def _drawn(self, request: TensorDictBase) -> Mapping[NestedKey, torch.Tensor]:
        """Values for a reset of all robots."""
        raise NotImplementedError

    def _accept(self, request: TensorDictBase) -> TensorDictBase:
        """Check the values of a request, drawn or chosen; return the request."""
        return request

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        request = self._request(tensordict)
        for key, value in self._drawn(request).items():
            draw_into_reset(request, key, value)
        return self._accept(request)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        for key in self.out_keys:
            tensordict_reset.set(key, tensordict[key])
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entries."""
        return extend_spec(observation_spec, self._sizes)

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the entries as ones that a caller may set."""
        return extend_spec(state_spec, self._sizes)


def draw_into_reset(request: TensorDictBase, key: NestedKey, draw: torch.Tensor) -> None:
    """Put `draw` into the request for a reset, unless the caller chose a value.

    A request with a `_reset` mask holds the values of the previous episode, not choices of the
    caller.
    """
    if request.get(key, None) is None or "_reset" in request:
        request.set(key, draw)


def reset_rows(request: TensorDictBase) -> torch.Tensor | None:
    """Mask (*b,) of the robots that a partial reset resets; None if all robots are reset, or none.

    Without a robot to reset, values of all robots are computed, and TorchRL uses none of them.
    """
    mask = request.get("_reset", None)
    if mask is None or mask.all() or not mask.any():
        return None
    return mask.reshape(request.batch_size)


def spread(value: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    """Values (m, k) of the m rows in a mask (*b,), in (*b, k).

    Each other row holds the values of a row in the mask, so that it is valid for transforms that
    compute with all rows.
    """
    nearest = (rows.flatten().cumsum(0) - 1).clamp(min=0)
    return value[nearest].unflatten(0, rows.shape)


def check_interval(interval: Any) -> float:
    """Mean time between random events, which may be infinite [s].

    Raises:
        ConfigurationError: it is no number, or shorter than a policy step.
    """
    real = isinstance(interval, Real) and not isinstance(interval, bool)
    if not real or not float(interval) >= CASSIE.policy_period:
        raise ConfigurationError(
            f"interval must be at least one policy step, {CASSIE.policy_period} s, got {interval!r}"
        )
    return float(interval)


def extend_spec(spec: Composite, sizes: Mapping[Any, int]) -> Composite:
    """Add unbounded single-precision leaves of the given last dimensions to a spec."""
    for key, size in sizes.items():
        spec[key] = Unbounded(torch.Size((*spec.shape, size)), dtype=torch.float32)
    return spec


def require_keys(transform: Transform, spec: TensorSpec, keys: Sequence[NestedKey]) -> None:
    """Check that a spec has all entries that a transform reads.

    Raises:
        UnknownNameError: a key is missing; the message lists the existing keys.
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


def checked_column(tensordict: TensorDictBase, key: NestedKey, size: int = 1) -> torch.Tensor:
    """Entry (*b, size) that a caller may have written, in single precision.

    Raises:
        ShapeError: the entry does not have `size` numbers per robot.
        ConfigurationError: a number is not finite.
    """
    value = torch.as_tensor(tensordict[key])
    expected = (*tensordict.batch_size, size)
    if tuple(value.shape) != expected:
        raise ShapeError(f"{key} must have shape {expected}, got {tuple(value.shape)}")
    if not torch.isfinite(value).all():
        raise ConfigurationError(f"{key} must be finite, got {value.tolist()}")
    return value.float()
