"""Decorators of functions that users call: torch's defaults, types of arguments."""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Real
from types import UnionType
from typing import Any, Final, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase

from aslip.errors import ConfigurationError

Function = TypeVar("Function", bound=Callable[..., Any])


_CPU: Final = torch.device("cpu")


def on_cpu_in_single(function: Function) -> Function:
    """Make a function create tensors in single precision on the CPU, whatever torch's defaults are.

    A method of an object with a `place` creates them on that device. Another library of the same
    program may change `torch.set_default_dtype` and `torch.set_default_device`. TorchRL's own
    tensors follow them, too, so that naming types and devices in this package would not suffice.
    """

    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> Any:
        kind, device = torch.get_default_dtype(), torch.get_default_device()
        place = getattr(args[0], "place", _CPU) if args else _CPU
        if kind == torch.float32 and device == place:
            return function(*args, **kwargs)
        torch.set_default_dtype(torch.float32)
        try:
            with place:
                return function(*args, **kwargs)
        finally:
            torch.set_default_dtype(kind)

    return cast("Function", run)


def check_types(function: Function) -> Function:
    """Make a function refuse arguments of other types than its annotations name.

    For functions that users call first: what they call can then rely on its arguments. Whole
    numbers, which have ranges and so checks of their own, other values, and items of iterators are
    not checked.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        with contextlib.suppress(TypeError):  # missing or unknown arguments: the call raises it
            given = signature.bind(*args, **kwargs).arguments
            for name, kind in get_type_hints(function).items():
                if name in given and not _is_a(got := given[name], kind):
                    if isinstance(got, Mapping):
                        items = ({key: value} for key, value in got.items())
                        got = next((item for item in items if not _is_a(item, kind)), got)
                    text = _WORDS.get(kind) or str(signature.parameters[name].annotation)
                    text = f"one of {get_args(kind)}" if get_origin(kind) is Literal else text
                    makers = [
                        f"{maker} makes one" for word, maker in _MAKERS.items() if word in text
                    ]
                    raise ConfigurationError(
                        "; ".join([f"{name} must be {text}, got {got!r:.80}", *makers])
                    )
        return function(*args, **kwargs)

    return cast("Function", checked)


# word in an annotation -> what makes such an object
_MAKERS = {
    "GaitLibrary": "aslip.GaitLibrary.load",
    "TensorDictModuleBase": "aslip.load_policy",
    "StackEnv": "aslip.make_env",
}
_WORDS = {float: "a number", bool: "True or False"}
# numbers and truth values of NumPy are as good as Python's
_NUMBERS = {float: Real, bool: bool | np.bool_}


def _is_a(value: Any, kind: Any) -> bool:
    """Check whether a value has the type of an annotation."""
    origin, kinds = get_origin(kind), get_args(kind)
    if kind in _NUMBERS:
        return isinstance(value, _NUMBERS[kind]) and (kind is bool or not isinstance(value, bool))
    if origin in (Union, UnionType):
        return any(_is_a(value, one) for one in kinds)
    if origin is Literal:
        return isinstance(value, str)
    if origin is Callable or kind is TensorDictModuleBase:
        return callable(value)
    if origin in (Sequence, Iterable):
        if isinstance(value, str | bytes):
            return isinstance(value, str) and _is_a(value, kinds[0])
        if isinstance(value, np.ndarray | torch.Tensor):
            return value.ndim > 0 and (kinds[0] in _NUMBERS or get_origin(kinds[0]) is Sequence)
        items = value if isinstance(value, list | tuple) else ()
        return isinstance(value, origin) and all(_is_a(item, kinds[0]) for item in items)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(_is_a(item, kinds[1]) for item in value.values())
    kind = origin or kind
    return kind is int or not isinstance(kind, type) or isinstance(value, kind)
