"""Closed-loop inverse kinematics of Cassie: pelvis and feet -> configuration and motor angles.

Pinocchio reads the same MJCF as the simulator, loops included. All arguments and results follow
MuJoCo's conventions (wxyz quaternions, `qpos` and `qvel` as in `mujoco.MjData`).
"""

from aslip.ik.kinematics import CassieKinematics, ForwardKinematics
from aslip.ik.solve import IkResidual, IkSolution, solve
from aslip.ik.standing import standing_pose
from aslip.ik.statics import static_torque
from aslip.ik.target import BodyTarget

__all__ = [
    "BodyTarget",
    "CassieKinematics",
    "ForwardKinematics",
    "IkResidual",
    "IkSolution",
    "solve",
    "standing_pose",
    "static_torque",
]
