"""Functions of Numba, compiled by Warp for GPUs, too."""

from __future__ import annotations

from typing import Any

import warp as wp

from aslip.base.arrays import python_function


def device_function(function: Any, kinds: dict[str, Any], **uses: Any) -> Any:
    """Function of Warp with the code of a function of the CPU.

    Args:
        function: function that `aslip.base.compiled.compiled` or nobody has compiled.
        kinds: argument -> type of Warp.
        uses: functions of Warp in place of those that the code calls, by name.
    """
    code = python_function(function, **uses)
    names = code.__code__.co_varnames[: code.__code__.co_argcount]
    code.__annotations__ = {name: kinds[name] for name in names}
    return wp.func(code)
