"""Statics: ground forces of both feet, and motor torques that balance them."""

from __future__ import annotations

import numpy as np

from aslip.errors import ShapeError
from aslip.ik.dynamics import motor_motion
from aslip.ik.kinematics import Kinematics
from aslip.robot.rotation import quaternion_to_matrix, rotate_back


def share_friction(force: np.ndarray) -> np.ndarray:
    """Ground forces with which the feet do not push against each other.

    The horizontal forces are shared between the feet in proportion to their vertical forces. Sums
    of the forces, vertical forces, and forces on a single foot stay as they are.

    Args:
        force: (..., 2, 3) ground force on the left and the right foot [N, z up].

    Returns:
        (..., 2, 3) forces on the same feet [N].
    """
    load = force[..., 2:]
    total = load.sum(axis=-2, keepdims=True)
    share = np.divide(load, total, out=np.zeros_like(load), where=total > 0)
    horizontal = share * force[..., :2].sum(axis=-2, keepdims=True)
    return np.concatenate([horizontal, load], axis=-1)


def static_torque(kinematics: Kinematics, qpos: np.ndarray, force: np.ndarray) -> np.ndarray:
    r"""Motor torques that balance forces of the ground on the soles, by virtual work.

    .. math:: \tau = -J^T F

    with the Jacobian J of the soles' centres with respect to the motors, pelvis held. Springs are
    rigid, as in the inverse kinematics, and the other joints follow the motors through the loops;
    the weight of the legs is left out.

    Args:
        kinematics: the robot.
        qpos: (n, nq) configurations with closed loops.
        force: (n, 2, 3) ground force at the centre of the left and the right sole [N, world].

    Returns:
        (n, motors) torques at the joints [N m], motor order.

    Raises:
        ShapeError: the arrays do not fit together.
    """
    if qpos.ndim != 2 or force.shape != (len(qpos), 2, 3):
        raise ShapeError(f"qpos (n, nq) needs force (n, 2, 3), got {qpos.shape}, {force.shape}")
    legs = kinematics.legs(kinematics.at_origin(kinematics.to_pinocchio(qpos)))
    orientation = qpos[:, None, kinematics.robot.indices.pelvis_orientation]
    local = rotate_back(quaternion_to_matrix(orientation), force)
    sole = legs.jacobian[..., :3, :] @ motor_motion(kinematics, legs)
    return -rotate_back(sole, local).reshape(len(qpos), -1)
