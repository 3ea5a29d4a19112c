"""Arithmetic on arrays of NumPy and on tensors of torch alike, so that laws are written once.

Torch knows NumPy's names of functions and arguments as far as this package uses them on either.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import FunctionType
from typing import Any

import numpy as np

Array = Any
"""Array of NumPy, or tensor of torch on any device."""


def is_numpy(array: Array) -> bool:
    """Whether an array or number is NumPy's."""
    return isinstance(array, np.ndarray | np.generic)


def namespace(array: Array) -> Any:
    """Module with the functions for an array: NumPy or torch."""
    return np if is_numpy(array) else sys.modules["torch"]


def copied(array: Array) -> Array:
    """Copy of an array."""
    return array.copy() if is_numpy(array) else array.clone()


def contiguous(array: Array) -> Array:
    """Array in rows, copied if it is not."""
    return np.ascontiguousarray(array) if is_numpy(array) else array.contiguous()


def zeros(shape: Sequence[int], like: Array) -> Array:
    """Zeros of the type and on the device of another array."""
    if is_numpy(like):
        return np.zeros(shape, like.dtype)
    return namespace(like).zeros(tuple(shape), dtype=like.dtype, device=like.device)


def python_function(function: Any, **uses: Any) -> Any:
    """Python function with the code of one that Numba may have compiled.

    Args:
        function: function of `aslip.base.compiled.compiled`, or any other.
        uses: what the code shall use in place of its own globals, by name.
    """
    function = getattr(function, "py_func", function)
    return FunctionType(function.__code__, {**function.__globals__, **uses}, function.__name__)
