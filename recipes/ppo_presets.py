"""Environments of the presets of `ppo_aslip.py`; `ppo_settings.py` has their settings."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import aslip
from aslip.envs import ON_TRUTH, default_stack, randomise_stack
from aslip.training.environments import make_training_env


def environments(preset: str) -> dict[str, Any]:
    """Environments of a preset, as arguments of `ppo_aslip.main`."""
    one_speed = partial(make_training_env, command_interval=math.inf)
    if preset in ("paper", "single_reference"):
        make_env = partial(aslip.make_env, stack=preset)
        return {"make_env": make_env, "make_train_env": partial(one_speed, make_env)}
    if preset == "robust":
        robots = partial(aslip.make_env, stack=randomise_stack(default_stack()))
        return {"make_train_env": partial(make_training_env, robots)}
    if preset == "truth":
        return {"make_env": partial(aslip.make_env, **ON_TRUTH)}
    return {}
