"""Numba compilation of loops that run at every substep or packet."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache

_warned = False


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of arrays and numbers at its first call, and cache it on disk.

    Division by zero follows NumPy. A change of the function's file renews the cache: constants and
    functions that it uses must be in the same file. Without a usable cache it is compiled in each
    process, which takes some seconds.
    """
    dispatcher = njit(nogil=True, error_model="numpy")(function)
    try:
        dispatcher._cache = _Cache(function)
    except RuntimeError as error:  # there is no folder to write to
        _warn(error)
    return dispatcher


class _Cache(FunctionCache):
    """Cache of which a file may be damaged, unreadable or impossible to write."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled function; None if it has to be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # damaged pickles raise errors of any kind
            _warn(error, self.cache_path)
            # empty, so that the function can be saved again
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled function if possible."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _warn(error, self.cache_path)


def _warn(error: Exception, folder: str = "") -> None:
    """Warn of the first error in this process."""
    global _warned
    if not _warned:
        _warned = True
        warnings.warn(
            f"Numba's cache {folder} cannot be used ({type(error).__name__}: {error}): functions"
            " are compiled again, which takes some seconds. If this happens again, delete the files"
            " of the cache, or let the environment variable NUMBA_CACHE_DIR name another folder",
            RuntimeWarning,
            stacklevel=2,
        )
