"""Numba compilation of loops that run at every substep or packet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of arrays and numbers at its first call, and cache it on disk.

    Division by zero follows NumPy. A change of the function's file renews the cache: constants and
    functions that it uses must be in the same file.
    """
    options = {"nogil": True, "error_model": "numpy"}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:
        # no writable folder for the cache: compiling takes some seconds per process
        return njit(**options)(function)
