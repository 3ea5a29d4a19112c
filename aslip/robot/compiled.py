"""Compilation by Numba of loops that run at every substep or packet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of arrays and numbers at its first call, and keep that on disk.

    Division by zero gives what it gives in NumPy. What is kept is renewed when the function's file
    changes, and only then: constants and functions that it reads must stand there, too.
    """
    options = {"nogil": True, "error_model": "numpy"}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:
        # neither the package nor the user has a folder to write to; compiling takes some seconds
        return njit(**options)(function)
