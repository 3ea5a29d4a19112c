"""Inverse dynamics: motor torques that carry and accelerate the legs."""

# pyright: reportAttributeAccessIssue=false
# Pinocchio is a compiled module without type stubs

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aslip.errors import ShapeError
from aslip.ik.equations import least_squares
from aslip.ik.kinematics import Kinematics, LegState
from aslip.robot.rotation import quaternion_to_matrix, rotate_back


def leg_torque(
    kinematics: Kinematics, qpos: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    r"""Motor torques that carry and accelerate the legs, without forces of the ground.

    .. math:: \tau = V^T f, \quad f = M(q)\,\ddot q + h(q, \dot q)

    with the generalized forces f of the recursive Newton-Euler algorithm, weight and reflected
    inertia of the motors included, and the joint velocities V per unit rate of each motor. The
    pelvis follows its motion, whatever force that takes. Springs are rigid and loops closed, as in
    the inverse kinematics.

    Args:
        kinematics: the robot.
        qpos: (n, nq) configurations with closed loops.
        velocity: (n, nv) velocities, all of the pelvis in its own axes (see `pelvis_axes`).
        acceleration: (n, nv) their derivatives with respect to time.

    Returns:
        (n, motors) torques at the joints [N m], motor order.

    Raises:
        ShapeError: the arrays do not fit together.
    """
    rates = (len(qpos), kinematics.model.nv)
    if qpos.ndim != 2 or not velocity.shape == acceleration.shape == rates:
        raise ShapeError(
            f"qpos (n, nq) needs velocity and acceleration (n, nv), got {qpos.shape},"
            f" {velocity.shape}, {acceleration.shape}"
        )
    configuration = kinematics.to_pinocchio(qpos)
    legs = kinematics.legs(kinematics.at_origin(configuration))
    data = kinematics.model.createData()
    force = np.array(
        [
            pin.rnea(kinematics.model, data, *instant)
            for instant in zip(configuration, velocity, acceleration, strict=True)
        ]
    )
    motion = motor_motion(kinematics, legs)
    return np.einsum("nskm,nsk->nsm", motion, force[:, kinematics.leg_v]).reshape(len(qpos), -1)


def motor_motion(kinematics: Kinematics, legs: LegState) -> np.ndarray:
    """Velocities (n, 2, k, m) of each leg's joints per unit rate of each of its m motors.

    One motor moves at a time, and the loops stay closed.

    Args:
        kinematics: the robot.
        legs: its legs in n configurations.
    """
    n, count = len(legs.position), kinematics.leg_motors.shape[1]
    motors = np.eye(kinematics.leg_v.shape[1])[kinematics.leg_motors]
    rows = np.broadcast_to(motors, (n, *motors.shape))
    constraint = np.concatenate((legs.closure_jacobian, rows), axis=-2)
    rate = np.eye(constraint.shape[-2])[:, -count:]
    return least_squares(constraint, np.broadcast_to(rate, (*constraint.shape[:-1], count)))


def pelvis_axes(kinematics: Kinematics, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Velocities (n, nv) with the linear velocity of the pelvis in its own axes.

    Args:
        kinematics: the robot.
        qpos: (n, nq) configurations.
        qvel: (n, nv) MuJoCo's velocities, whose linear part is in the axes of the world.
    """
    indices, velocity = kinematics.robot.indices, qvel.copy()
    turn = quaternion_to_matrix(qpos[:, indices.pelvis_orientation])
    linear = indices.pelvis_velocity
    velocity[:, linear] = rotate_back(turn, qvel[:, linear])
    return velocity
