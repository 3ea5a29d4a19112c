"""The shipped gait library, small environments, and what several test modules compare with."""

from __future__ import annotations

import ctypes.util
import os
from collections.abc import Callable
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase

# pictures are tested in software where there is no display; MuJoCo asks once, at its import
if "DISPLAY" not in os.environ and ctypes.util.find_library("OSMesa"):
    os.environ.setdefault("MUJOCO_GL", "osmesa")

import aslip
from aslip.library import GaitLibrary
from aslip.stack import CassieTransformedEnv

# the machine is shared, and no test gains from more
torch.set_num_threads(1)

MakeEnv = Callable[..., CassieTransformedEnv]


@pytest.fixture(scope="session")
def library() -> GaitLibrary:
    """The library that ships with the package."""
    return GaitLibrary.load()


@pytest.fixture
def make(library: GaitLibrary) -> MakeEnv:
    """`aslip.make_env` with the library at hand and one physics thread."""

    def make(backend: str = "batch", **settings: Any) -> CassieTransformedEnv:
        defaults: dict[str, Any] = {"num_threads": 1}
        if isinstance(settings.get("stack", "aslip"), str):
            defaults["library"] = library
        return aslip.make_env(backend, **{**defaults, **settings})  # pyright: ignore

    return make


def leaves(td: TensorDictBase) -> dict[tuple[str, ...], torch.Tensor]:
    """All tensors of a tensordict by their full keys."""
    return {
        (key,) if isinstance(key, str) else key: value
        for key, value in td.items(include_nested=True, leaves_only=True)
    }


def differing(a: TensorDictBase, b: TensorDictBase) -> list[str]:
    """Keys that only one has, or whose bits differ (NaN equals NaN)."""
    left, right = leaves(a), leaves(b)
    odd = ["/".join(key) for key in left.keys() ^ right.keys()]
    return sorted(odd) + sorted(
        "/".join(key)
        for key in left.keys() & right.keys()
        if left[key].dtype != right[key].dtype
        or not torch.allclose(left[key], right[key], rtol=0, atol=0, equal_nan=True)
    )
