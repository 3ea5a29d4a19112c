"""Checks of arguments for simulations and environments: counts, robots and states."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import numpy as np

from aslip.errors import ConfigurationError, ShapeError


def check_count(name: str, value: Any, least: int = 1, most: int | None = None) -> int:
    """Return a count as a Python number; whole numbers of NumPy are counts, too.

    Raises:
        ConfigurationError: `value` is not a whole number from `least` to `most`.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise ConfigurationError(f"{name} must be a whole number of {least} or more, got {value!r}")
    count = int(value)
    if most is not None and count > most:
        raise ConfigurationError(f"{name} must be {most} or less, got {count}")
    return count


def check_ids(ids: Any, num: int) -> np.ndarray:
    """Return robots of `num` as indices (k,).

    Raises:
        ConfigurationError: `ids` are not ascending, unique whole numbers from 0 to `num` - 1.
    """
    robots = np.asarray(ids)
    if robots.size == 0:
        return np.zeros(0, dtype=int)
    whole = robots.ndim == 1 and np.issubdtype(robots.dtype, np.integer)
    if not whole or robots[0] < 0 or robots[-1] >= num or (np.diff(robots) <= 0).any():
        raise ConfigurationError(
            f"ids must be sorted, unique and of robots 0 to {num - 1}, got {robots.tolist()}"
        )
    return robots


def check_states(states: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return states as an array of doubles.

    Raises:
        ShapeError: the shape of `states` is not `shape`.
    """
    array = np.asarray(states, dtype=np.float64)
    if array.shape != shape:
        raise ShapeError(
            f"states must have shape {shape}, got {array.shape}; they must come from states() of"
            " the same number of robots and the same model"
        )
    return array
