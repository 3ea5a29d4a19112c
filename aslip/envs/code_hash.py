"""Hash of what a function does, to tell two of the same name apart."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterator
from functools import partial
from types import CodeType, FunctionType, MethodType
from typing import Any


def function_text(function: Callable[..., Any], text: Callable[[Any], str]) -> str:
    """Name of a function and a hash of its code; the same in every process.

    The hash covers the byte code, constants, names, default arguments and closure, but not the line
    in the file. It differs between minor versions of Python, and does not follow calls: an edit of
    a function that this one calls goes unnoticed.

    Args:
        function: a function, lambda, bound method or `functools.partial`.
        text: tells what a bound value is, in the same words in every process.
    """
    if isinstance(function, partial):
        given = ", ".join([*map(text, function.args), text(function.keywords)])
        return f"partial({text(function.func)}, {given})"
    if isinstance(function, MethodType):
        return f"{text(function.__self__)}.{function_text(function.__func__, text)}"
    assert isinstance(function, FunctionType)
    return _named_hash(function, text, ())


def _named_hash(
    function: FunctionType, text: Callable[[Any], str], within: tuple[FunctionType, ...]
) -> str:
    """Name and hash of a function that is bound in those it is within, if in any."""
    if function in within:
        return function.__qualname__  # it refers to itself
    bound = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).items()]
    told = [
        _named_hash(value, text, (*within, function))
        if isinstance(value, FunctionType)
        else text(value)
        for value in [*bound, *_closure(function)]
    ]
    digest = hashlib.sha256("\n".join([*_code_parts(function.__code__), *told]).encode())
    return f"{function.__qualname__}#{digest.hexdigest()[:12]}"


def _closure(function: FunctionType) -> Iterator[Any]:
    """Values of a function's free variables; a variable not bound yet has none."""
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):
            yield cell.cell_contents


def _code_parts(code: CodeType) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr([code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars])
    yield repr([code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags])
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _code_parts(constant)
        elif isinstance(constant, frozenset):
            # its order is that of hashes, which differ between processes
            yield repr(sorted(map(repr, constant)))
        else:
            yield repr(constant)
