"""Functions are told apart by what they do, in the same words in every process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from aslip.envs import describe_transforms
from aslip.envs.interface import function_text
from aslip.transforms import RewardTerm
from tests.helpers import MakeEnv

ROOT = Path(__file__).parents[2]


def told(function: Callable[..., Any]) -> str:
    return function_text(function, repr)


def scaled(scale: Any) -> Callable[..., Any]:
    return lambda x: scale * x


def nested(power: int) -> Callable[..., Any]:
    """Functions that differ in what a function within them is bound to."""
    inner = scaled(power)
    return lambda x: inner(x)


PAIRS: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "code": (lambda x: x + 1, lambda x: x - 1),
    "constant": (lambda x: x + 1, lambda x: x + 2),
    "name": (lambda x: x.sin(), lambda x: x.cos()),
    "argument": (lambda x, y: x, lambda x: x),
    "default": (lambda x, scale=1: scale * x, lambda x, scale=2: scale * x),
    "keyword": (lambda x, *, scale=1: scale * x, lambda x, *, scale=2: scale * x),
    "closure": (scaled(1), scaled(2)),
    "closure of a closure": (nested(1), nested(2)),
    "code within": (lambda x: [y + 1 for y in x], lambda x: [y + 2 for y in x]),
    "set": (lambda x: x in {"a", "b"}, lambda x: x in {"a", "c"}),
    "partial": (partial(max, 1), partial(max, 2)),
    "keyword of a partial": (partial(dict, key=1), partial(dict, key=2)),
}


@pytest.mark.parametrize("name", PAIRS)
def test_functions_that_do_something_else_are_told_apart(name: str) -> None:
    one, other = PAIRS[name]
    assert told(one) != told(other)
    assert told(one) == told(one)


def test_the_same_function_elsewhere_is_the_same() -> None:
    def made() -> Callable[..., Any]:
        return scaled(3)

    first, second = made(), scaled(3)
    before = told(first)
    assert before == told(second)
    for _ in range(1000):
        first(1.0)  # the interpreter adapts the code of what is called often
    assert told(first) == before


def test_a_function_that_calls_itself_is_told() -> None:
    def factorial(n: int) -> int:
        return n and n * factorial(n - 1)

    def even(n: int) -> bool:
        return n == 0 or odd(n - 1)

    def odd(n: int) -> bool:
        return n != 0 and even(n - 1)

    assert len({told(factorial), told(even), told(odd)}) == 3


def test_the_text_is_the_same_in_every_process() -> None:
    """Though sets of text are in another order in each, and objects at another address."""
    code = """
from functools import partial
from aslip.envs.interface import function_text
def bound(kept): return lambda x, scale=2.0: [y for y in x if y in {"a", "b", "c"} and kept]
print(function_text(partial(bound({}), scale=3), lambda value: getattr(value, "__qualname__", "")))
print(function_text(bound(object()), lambda value: type(value).__name__))
"""
    texts = set()
    for seed in "123":
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", code]
        texts.add(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)
    assert len(texts) == 1
    assert b"#" in texts.pop()


def test_rewards_that_are_different_functions_are_different_experiments(make: MakeEnv) -> None:
    def text(function: Callable[..., Any]) -> str:
        term = partial(RewardTerm, "foot_orient", function, [("truth", "pelvis_orientation")])
        return describe_transforms(make(replace={"foot_orient": term}))["foot_orient"]

    def zero(q: torch.Tensor) -> torch.Tensor:
        return 0 * q[..., :1]

    assert text(lambda q: q[..., :1].abs()) != text(lambda q: 0 * q[..., :1])
    assert text(lambda q: q[..., :1].abs()) == text(lambda q: q[..., :1].abs())
    assert text(partial(zero)) == text(partial(zero))
    assert "zero#" in text(zero)
