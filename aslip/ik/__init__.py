"""Inverse kinematics of legs with closed loops: pelvis and feet -> configuration, motor angles.

Pinocchio reads the MJCF of the simulator, loops included, and gives frames, Jacobians and loop
closures. All arguments and results follow MuJoCo's conventions (wxyz quaternions, `qpos` and `qvel`
as in `mujoco.MjData`).
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
