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

from typing import TYPE_CHECKING

from aslip import errors
from aslip.imports import attach, mujoco_gl_problem

if TYPE_CHECKING:
    from aslip.control import Controller
    from aslip.envs import GymEnv, GymVectorEnv, RobotEnv, default_stack, make_env
    from aslip.library import GaitLibrary, Reference
    from aslip.policy import load_policy
    from aslip.rom import Gait, Motion

__version__ = "0.1.0"

# before anything imports MuJoCo
mujoco_gl_problem()

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


__getattr__, _ = attach(
    "aslip",
    {
        "control": ["Controller"],
        "envs": ["GymEnv", "GymVectorEnv", "RobotEnv", "default_stack", "make_env"],
        "library": ["GaitLibrary", "Reference"],
        "policy": ["load_policy"],
        "rom": ["Gait", "Motion"],
    },
)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
