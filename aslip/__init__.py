"""Legged locomotion learned under the guidance of a reduced-order model.

A library of optimal actuated-SLIP walking gaits guides a policy for the biped Cassie
(Green et al. 2021, "Learning Spring Mass Locomotion"). The public surface is small:

    env = aslip.make_env(num_envs=64, seed=0)     # TorchRL environment with the full stack
    library = aslip.GaitLibrary.load()            # 21 gaits, 0 to 2 m/s, with motor angles
    policy = aslip.load_policy("runs/my_run")     # tensordict in, `action` out
    aslip.Motion, aslip.RobotEnv, aslip.Controller  # what to replace: gaits, robot, control loop

Names are imported on first use: `import aslip` alone loads no library.
"""

from aslip.base.imports import attach, mujoco_gl_problem

__version__ = "0.1.0"

# before anything imports MuJoCo
mujoco_gl_problem()

__getattr__, __dir__, __all__ = attach(__name__, __file__)
