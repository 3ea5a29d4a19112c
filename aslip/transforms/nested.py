"""Functions of dataclasses, dictionaries and tuples of tensors or arrays, of any depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor


def mapped(function: Callable[..., Any], value: Any, *others: Any) -> Any:
    """Value with a function applied to all arrays in it, and to those of others that are alike."""
    if isinstance(value, tuple):
        return tuple(mapped(function, *items) for items in zip(value, *others, strict=True))
    if isinstance(value, dict):
        return {key: mapped(function, *(v[key] for v in (value, *others))) for key in value}
    if is_dataclass(value):
        return type(value)(**mapped(function, *map(vars, (value, *others))))
    return function(value, *others)


def chosen(mask: Tensor, one: Any, other: Any) -> Any:
    """Values of one of two alike, by a mask (n,) of robots."""
    return mapped(partial(_choose, mask), one, other)


def to_double(value: Tensor) -> Tensor:
    """Tensor in double precision; one of integers stays."""
    return value.double() if value.is_floating_point() else value


def to_numpy(value: Tensor) -> np.ndarray:
    """Array in double precision; one of integers stays."""
    return to_double(value).cpu().numpy()


def to_single(device: torch.device, value: np.ndarray | Tensor) -> Tensor:
    """Tensor in single precision; one of integers stays."""
    tensor = torch.as_tensor(value, device=device)
    return tensor.float() if tensor.is_floating_point() else tensor


def _choose(mask: Tensor, one: Tensor, other: Tensor) -> Tensor:
    return torch.where(mask.reshape(-1, *(1,) * (one.ndim - 1)), one, other)
