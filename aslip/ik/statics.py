"""What the motors must exert for the legs to carry a load."""

from __future__ import annotations

import numpy as np

from aslip.errors import ShapeError
from aslip.ik.equations import ACHILLES, POSITION, Equations
from aslip.ik.kinematics import PELVIS_ORIENTATION, CassieKinematics
from aslip.ik.leg import JOINTS, KNEE, MOTORS, TARSUS
from aslip.ik.rotation import quaternion_to_matrix, rotate_back


def static_torque(kinematics: CassieKinematics, qpos: np.ndarray, force: np.ndarray) -> np.ndarray:
    r"""Motor torques that balance forces of the ground on the soles, by virtual work.

    .. math:: \tau = -J^T F

    with the Jacobian of the soles' centres in the pelvis frame. Springs are rigid, as in the
    inverse kinematics, so that the Achilles rod makes the tarsus follow the knee; the weight of the
    legs is left out.

    Args:
        kinematics: the robot.
        qpos: (n, 35) configurations with closed loops.
        force: (n, 2, 3) on the left and the right sole's centre [N, world].

    Returns:
        (n, 10) torques at the joints [N m], motor order.

    Raises:
        ShapeError: the arrays do not fit together.
    """
    if qpos.ndim != 2 or force.shape != (len(qpos), 2, 3):
        raise ShapeError(f"qpos (n, 35) needs force (n, 2, 3), got {qpos.shape}, {force.shape}")
    angle = qpos[:, kinematics.hinge_q]
    anywhere = np.zeros_like(force), np.broadcast_to(np.eye(3), (*force.shape, 3))
    jacobian = Equations.at(kinematics.legs, angle, *anywhere).jacobian()
    sole = jacobian[..., POSITION, :].copy()
    rod = jacobian[..., ACHILLES, :]
    follows = -rod[..., KNEE] / rod[..., TARSUS]
    sole[..., KNEE] += sole[..., TARSUS] * follows[..., None]
    pelvis_to_world = quaternion_to_matrix(qpos[:, None, PELVIS_ORIENTATION])
    local = rotate_back(pelvis_to_world, force)
    torque = -np.einsum("nsij,nsi->nsj", sole, local)
    assert torque.shape[-1] == len(JOINTS)
    return torque[..., MOTORS].reshape(len(qpos), -1)
