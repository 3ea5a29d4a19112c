"""Simulated device: tensors that report another device and refuse to mix with those of the CPU.

Numbers live on the CPU; what would wait for a GPU, or copy from it, is noted in `VISITS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map
from torch.utils.backend_registration import (
    _DummyBackendModule,
    _setup_privateuseone_for_python_backend,
)

PLACE = "elsewhere"
VISITS: list[str] = []
"""Copies of arrays to the host, and waits for numbers, in their order."""


class _Backend(_DummyBackendModule):
    def synchronize(self, *_: object) -> None:
        VISITS.append("wait")

    def manual_seed_all(self, seed: int) -> None:
        del seed

    def _is_in_bad_fork(self) -> bool:
        return False


_setup_privateuseone_for_python_backend(PLACE, backend_module=_Backend())
DEVICE = torch.device(PLACE, 0)


# address of a generator of the device -> it; torch passes others that share its state
_DRAWING: dict[int, torch.Generator] = {}


class Generator(torch.Generator):
    """Random numbers of a device, which torch makes on the CPU."""

    def __new__(cls, place: torch.device | str = "cpu") -> Self:
        made = super().__new__(cls)
        made.place = torch.device(place)
        if made.place == DEVICE:
            _DRAWING[made._cdata] = made
        return made

    @property
    def device(self) -> torch.device:
        return self.place

    def clone_state(self) -> torch.Generator:
        clone = Generator(self.place)
        clone.set_state(self.get_state())
        return clone


class Elsewhere(Tensor):
    """Tensor on the simulated device."""

    @staticmethod
    def __new__(cls, here: Tensor) -> Elsewhere:
        tensor = Tensor._make_wrapper_subclass(  # pyright: ignore[reportAttributeAccessIssue]
            cls, here.size(), strides=here.stride(), dtype=here.dtype, device=DEVICE,
            requires_grad=here.requires_grad, storage_offset=here.storage_offset(),
        )  # fmt: skip
        tensor.here = here
        return tensor

    __torch_function__ = torch._C._disabled_torch_function_impl  # pyright: ignore

    def tolist(self) -> Any:
        VISITS.append("list")
        return self.here.tolist()

    @classmethod
    def __torch_dispatch__(
        cls, function: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        return _run(function, args, kwargs or {})


def here(value: Any) -> Any:
    """Numbers of tensors on the simulated device; other values themselves."""
    return tree_map(lambda x: x.here if isinstance(x, Elsewhere) else x, value)


def there(value: Any) -> Any:
    """Tensors on the simulated device."""
    return tree_map(lambda x: Elsewhere(x) if isinstance(x, Tensor) else x, value)


def _run(function: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    tensors = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
    moved = any(isinstance(x, Elsewhere) for x in tensors)
    name = function._schema.name.removeprefix("aten::")
    if name == "_to_copy":
        device = kwargs.pop("device", None) or tensors[0].device
        if moved and torch.device(device).type == "cpu":
            VISITS.append("copy")
        copied = function(*here(args), **kwargs)
        return copied if torch.device(device).type == "cpu" else Elsewhere(copied)
    if name == "_local_scalar_dense":
        VISITS.append("number")
        return function(*here(args))
    if moved and name not in ("copy_", "index.Tensor", "index_put_"):
        alone = [x for x in tensors if not isinstance(x, Elsewhere) and x.dim() > 0]
        assert not alone, f"{function} mixes devices"
    if kwargs.get("device") is not None:
        moved = torch.device(kwargs["device"]).type == PLACE
        kwargs = {**kwargs, "device": torch.device("cpu")}
    if moved and (generator := kwargs.get("generator")) is not None:
        assert generator._cdata in _DRAWING, f"{function} draws from the CPU"
    result = function(*here(args), **here(kwargs))
    if name.endswith("_") and not name.startswith("_"):
        return args[0]
    return there(result) if moved else result


# operations that make tensors there without any argument that is there
_LIBRARY = torch.library.Library("_", "IMPL", "PrivateUse1")
_LIBRARY.fallback(lambda function, *args, **kwargs: _run(function, args, kwargs))


class OnElsewhere(TorchFunctionMode):
    """Let `torch.tensor` make tensors there; it does not call the library above."""

    def __torch_function__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        kwargs = dict(kwargs or {})
        if func is Tensor.new_tensor and isinstance(args[0], Elsewhere):
            return Elsewhere(torch.tensor(args[1], dtype=kwargs.get("dtype", args[0].dtype)))
        device = torch.device(kwargs.get("device") or "cpu")
        if func in (torch.tensor, torch.as_tensor, torch.arange) and device.type == PLACE:
            del kwargs["device"]
            if isinstance(args[0], Elsewhere):
                return args[0].to(kwargs.get("dtype") or args[0].dtype)
            return Elsewhere(func(*args, **kwargs))
        return func(*args, **kwargs)
