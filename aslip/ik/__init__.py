"""Inverse kinematics of legs with closed loops: pelvis and feet -> configuration, motor angles.

Pinocchio reads the MJCF of the simulator, loops included, and gives frames, Jacobians and loop
closures. All arguments and results follow MuJoCo's conventions (wxyz quaternions, `qpos` and `qvel`
as in `mujoco.MjData`).
"""

from aslip.ik.clearance import LegClearance
from aslip.ik.dynamics import leg_torque, pelvis_axes
from aslip.ik.kinematics import Kinematics
from aslip.ik.solve import IkResidual, IkSolution, solve
from aslip.ik.statics import share_friction, static_torque
from aslip.ik.target import BodyTarget

__all__ = [
    "BodyTarget",
    "IkResidual",
    "IkSolution",
    "Kinematics",
    "LegClearance",
    "leg_torque",
    "pelvis_axes",
    "share_friction",
    "solve",
    "static_torque",
]
