"""Settings that the recipe may not have."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from aslip.errors import ConfigurationError
from benchmarks.faults.trainings import TINY
from recipes import ppo_aslip

_JUNK = (None, "", "8", b"8", [], [8], (), {}, {8: 8}, object(), 1j, float("nan"), float("inf"))


def settings(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: an error that names the setting."""
    del folder
    survived = 0
    names = [field.name for field in fields(ppo_aslip.Config)]
    for name in rng.choice(names, count).tolist():
        try:
            replace(TINY, **{name: bad_value(name, rng)})
        except ConfigurationError as error:
            survived += name in str(error)
        except Exception:
            continue
    return survived


def bad_value(name: str, rng: np.random.Generator) -> Any:
    """A value that a setting of the recipe may not have."""
    default = getattr(ppo_aslip.Config(), name)
    junk: list[Any] = [value for value in _JUNK if type(value) is not type(default)]
    if isinstance(default, bool):
        junk += [0, 1, 2]
    elif isinstance(default, int):
        junk += [True, False, 2.5, 8.0, -int(rng.integers(1, 2**40)), -(10**30)]
    elif isinstance(default, float):
        junk += [True, -float(rng.exponential()) - 1e-12, float("nan"), -float("inf"), 10**400]
    elif isinstance(default, str):
        junk += ["", "ASLIP", default + " ", 3, True]
    else:
        junk += [3, True, 2.5]
    return junk[int(rng.integers(len(junk)))]
