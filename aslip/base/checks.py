"""Checks of arguments: numbers, counts, robots and states."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any, Final

import numpy as np

from aslip.errors import ConfigurationError, ShapeError

TINY: Final = float(np.finfo(np.float32).tiny)
"""Least positive number of settings."""


def check_number(
    name: str, value: Any, low: float = -math.inf, high: float = math.inf, what: str = ""
) -> float:
    """Check that a setting is a finite number from `low` to `high`, and return it as a float.

    Args:
        name: name of the setting, for the message.
        value: number to check.
        low: least value.
        high: greatest value.
        what: meaning and unit, for the message.

    Raises:
        ConfigurationError: `value` is no such number.
    """
    real = isinstance(value, Real) and not isinstance(value, bool)
    number = float(value) if real else math.nan
    if not math.isfinite(number) or not low <= number <= high:
        limits = "" if -low == high == math.inf else f" from {low:g} to {high:g}"
        meaning = f" ({what})" if what else ""
        raise ConfigurationError(f"{name} must be a finite number{limits}{meaning}, got {value!r}")
    return number


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
    """Return indices (k,) of some of `num` robots.

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
