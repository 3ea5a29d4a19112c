"""Settings of trainings and environments: wrong ones are refused by name."""

import math
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import aslip
from aslip.errors import AslipError, ConfigurationError
from aslip.training.settings import check_types
from recipes import ppo_aslip
from tests.helpers import TINY

JUNK = (None, "", "8", b"8", [], [8], (), {}, object(), 1j, math.nan, math.inf)
WRONG: dict[type, tuple[object, ...]] = {
    bool: (0, 1),
    int: (True, 2.5, 8.0, -1),
    float: (True, math.nan, -math.inf, -1e-12, 10**400),
    str: (3, True, "ASLIP"),
    Path: (3, True),
    type(None): (3, True),  # or a text
}
"""Values that settings of a type refuse besides those of `JUNK` that have another type."""


@pytest.mark.parametrize("field", fields(ppo_aslip.Config), ids=lambda field: field.name)
def test_error_names_setting_of_wrong_type(field: Any) -> None:
    kind = type(getattr(ppo_aslip.Config(), field.name))
    kind = Path if issubclass(kind, Path) else kind
    right = {kind, str} if kind is type(None) else {kind}
    for value in [*(junk for junk in JUNK if type(junk) not in right), *WRONG[kind]]:
        with pytest.raises(ConfigurationError, match=field.name):
            replace(TINY, **{field.name: value})


def test_accepts_settings_of_right_types() -> None:
    for preset in ppo_aslip.PRESETS.values():
        check_types(preset)
    check_types(replace(TINY, gamma=1, learning_rate=np.float64(1e-3), out=Path()))


@pytest.mark.parametrize("name", ["num_envs", "seed", "num_threads", "backend", "reward_on"])
def test_make_env_refuses_invalid_settings(name: str) -> None:
    settings: dict[str, Any] = {}
    none = () if name == "seed" else (None,)
    for settings[name] in (*none, "", "8", b"8", [], {}, 2.5, -1, math.nan, math.inf, object()):
        with pytest.raises(AslipError, match=name):
            aslip.make_env(**settings)
