"""Legged locomotion learned under the guidance of a reduced-order model.

A library of optimal actuated-SLIP walking gaits guides a policy for the biped Cassie
(Green et al. 2021, "Learning Spring Mass Locomotion"). The public surface is small:

    env = aslip.make_env(num_envs=64, seed=0)     # TorchRL environment with the full stack
    library = aslip.GaitLibrary.load()            # 21 gaits, 0 to 2 m/s, with motor angles
    policy = aslip.load_policy("runs/my_run")     # tensordict in, `action` out
    aslip.Motion, aslip.RobotEnv, aslip.Controller  # what to replace: gaits, robot, control loop

Names are imported on first use: `import aslip` alone loads no library.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from aslip import errors

if TYPE_CHECKING:
    from aslip.control import Controller
    from aslip.envs import GymEnv, GymVectorEnv, RobotEnv, default_stack, make_env
    from aslip.library import GaitLibrary, Reference
    from aslip.policy import load_policy
    from aslip.rom import Gait, Motion

__version__ = "0.1.0"

_HOME = {
    "Controller": "aslip.control",
    "Gait": "aslip.rom",
    "GaitLibrary": "aslip.library",
    "GymEnv": "aslip.envs",
    "GymVectorEnv": "aslip.envs",
    "Motion": "aslip.rom",
    "Reference": "aslip.library",
    "RobotEnv": "aslip.envs",
    "default_stack": "aslip.envs",
    "load_policy": "aslip.policy",
    "make_env": "aslip.envs",
}

__all__ = [
    "Controller",
    "Gait",
    "GaitLibrary",
    "GymEnv",
    "GymVectorEnv",
    "Motion",
    "Reference",
    "RobotEnv",
    "__version__",
    "default_stack",
    "errors",
    "load_policy",
    "make_env",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'aslip' has no attribute {name!r}; public names: {__all__}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
