"""Functions of Numba, compiled by Warp for GPUs, too."""

from __future__ import annotations

from types import FunctionType
from typing import Any

import warp as wp


def device_function(function: Any, kinds: dict[str, Any], **uses: Any) -> Any:
    """Function of Warp with the code of a compiled function of the CPU.

    Args:
        function: function that `aslip.base.compiled.compiled` or nobody has compiled.
        kinds: argument -> type of Warp.
        uses: functions of Warp in place of those that the code calls, by name.
    """
    function = getattr(function, "py_func", function)
    copied = FunctionType(
        function.__code__, {**function.__globals__, **uses}, f"{function.__name__}"
    )
    copied.__annotations__ = {
        name: kinds[name] for name in function.__code__.co_varnames[: function.__code__.co_argcount]
    }
    return wp.func(copied)
