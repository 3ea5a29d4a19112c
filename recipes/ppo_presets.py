"""Environments of the presets of `ppo_aslip.py`; `ppo_settings.py` has their settings."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from ppo_settings import Config

import aslip
from aslip.envs import ON_TRUTH, default_stack, randomise_stack
from aslip.library import GaitLibrary
from aslip.training.environments import make_training_env


def own_library(config: Config) -> GaitLibrary | None:
    """Library of the settings; None for that of the preset."""
    return None if config.library is None else GaitLibrary.load(config.library)


def environments(config: Config) -> dict[str, Any]:
    """Environments of a preset on the library of the settings, as arguments of `ppo_aslip.main`."""
    preset, library = config.preset, own_library(config)
    make_env = partial(aslip.make_env, library=library)
    one_speed = partial(make_training_env, command_interval=math.inf)
    if preset in ("paper", "single_reference"):
        make_env = partial(make_env, stack=preset)
        return {"make_env": make_env, "make_train_env": partial(one_speed, make_env)}
    if preset == "robust":
        robots = partial(aslip.make_env, stack=randomise_stack(default_stack(library)))
        return {"make_env": make_env, "make_train_env": partial(make_training_env, robots)}
    if preset == "truth":
        return {"make_env": partial(make_env, **ON_TRUTH)}
    return {"make_env": make_env}
