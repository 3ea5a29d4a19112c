"""Readings of the encoders and IMUs of all robots, as compiled loops."""

from __future__ import annotations

from typing import Final

import numpy as np

from aslip.base.compiled import compiled

MOTOR_VELOCITY_TAPS: Final = np.array([2727, 534, -2658, -795, 72, 110, 19, -6, -3], dtype=float)
"""Filter taps from a motor's counts to its velocity, newest first; the unit of the sum is counts
per step times pi (public simulator)."""

_TAPS = len(MOTOR_VELOCITY_TAPS)
OLDEST_FIRST = MOTOR_VELOCITY_TAPS[::-1].copy()


@compiled
def read_encoders(
    qpos: np.ndarray,
    qvel: np.ndarray,
    encoders: np.ndarray,
    angle: np.ndarray,
    count: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    inertial: np.ndarray,
    motor_step: np.ndarray,
    velocity_step: np.ndarray,
    orientation: int,
    spin: int,
) -> None:
    """Read encoders and IMU of all robots in one substep.

    Args:
        qpos: (n, 35) generalised positions.
        qvel: (n, 32) generalised velocities.
        encoders: (16,) indices of the encoders in `qpos`, motors first.
        angle: (n, 16) output.
        count: (9, n, 10) last counts, oldest first; the newest is output.
        position: (n, 10) output.
        velocity: (n, 10) output.
        inertial: (13, n) attitude and angular velocity are output.
        motor_step: (10,) angle of one count [rad].
        velocity_step: (10,) velocity of one unit of the sum of taps times counts [rad/s].
        orientation: start of the pelvis' quaternion in `qpos`.
        spin: start of its angular velocity in `qvel`.
    """
    for i in range(qpos.shape[0]):
        for j in range(encoders.size):
            angle[i, j] = qpos[i, encoders[j]]
        for j in range(position.shape[1]):
            counted = np.trunc(angle[i, j] / motor_step[j])
            count[-1, i, j] = counted
            position[i, j] = counted * motor_step[j]
            # a sum of whole numbers is exact in any order
            total = 0.0
            for k in range(_TAPS):
                total += OLDEST_FIRST[k] * count[k, i, j]
            velocity[i, j] = total * velocity_step[j]
        for j in range(4):
            inertial[j, i] = qpos[i, orientation + j]
        for j in range(3):
            inertial[4 + j, i] = qvel[i, spin + j]


def filter_step(
    numerator: np.ndarray, denominator: np.ndarray, memory: np.ndarray, value: float
) -> float:
    """One step of a filter in direct form II transposed; its memory (order,) changes in place."""
    order = memory.shape[0]
    filtered = memory[0] + numerator[0] * value
    for k in range(1, order):
        memory[k - 1] = memory[k] + value * numerator[k] - filtered * denominator[k]
    memory[order - 1] = value * numerator[order] - filtered * denominator[order]
    return filtered


_filter_step = compiled(filter_step)


@compiled
def filter_joints(
    numerator: np.ndarray,
    denominator: np.ndarray,
    values: np.ndarray,
    memory: np.ndarray,
    out: np.ndarray,
) -> None:
    """Filter values (t, n, k) along time like `scipy.signal.lfilter`.

    The memory (order, n, k) changes in place.
    """
    for t in range(values.shape[0]):
        for i in range(values.shape[1]):
            for j in range(values.shape[2]):
                out[t, i, j] = _filter_step(
                    numerator, denominator, memory[:, i, j], values[t, i, j]
                )


@compiled
def fill_encoders(
    motor_count: np.ndarray,
    motor_step: np.ndarray,
    motor_velocity: np.ndarray,
    sent_motor_position: np.ndarray,
    sent_motor_velocity: np.ndarray,
    joint_angle: np.ndarray,
    joint_step: np.ndarray,
    numerator: np.ndarray,
    denominator: np.ndarray,
    memory: np.ndarray,
    sent_joint_position: np.ndarray,
    sent_joint_velocity: np.ndarray,
) -> None:
    """Fill packets (n, w, k) with the encoders' readings at their last substeps.

    Args:
        motor_count: (t, n, 10) counts of the substeps.
        motor_step: (10,) angle of one count [rad].
        motor_velocity: (t, n, 10) velocities [rad/s].
        sent_motor_position: output.
        sent_motor_velocity: output.
        joint_angle: (t, n, 6) angles [rad].
        joint_step: (6,) angle of one count [rad].
        numerator: (4,) coefficients of the filter from angle to velocity.
        denominator: (4,) coefficients of the filter.
        memory: (3, n, 6) memory of the filter; changes in place.
        sent_joint_position: output.
        sent_joint_velocity: output.
    """
    substeps, num, joints = joint_angle.shape
    per = substeps // sent_motor_position.shape[1]
    angle, velocity = np.empty((substeps, num, joints)), np.empty((substeps, num, joints))
    for t in range(substeps):
        for i in range(num):
            for j in range(joints):
                angle[t, i, j] = np.trunc(joint_angle[t, i, j] / joint_step[j]) * joint_step[j]
    filter_joints(numerator, denominator, angle, memory, velocity)
    for k in range(substeps // per):
        last = (k + 1) * per - 1
        for i in range(num):
            for j in range(motor_step.size):
                sent_motor_position[i, k, j] = motor_count[last, i, j] * motor_step[j]
                sent_motor_velocity[i, k, j] = motor_velocity[last, i, j]
            for j in range(joints):
                sent_joint_position[i, k, j] = angle[last, i, j]
                sent_joint_velocity[i, k, j] = velocity[last, i, j]


@compiled
def fill_imu(
    inertial: np.ndarray,
    gravity: np.ndarray,
    tilt: np.ndarray,
    imu: np.ndarray,
    sent_orientation: np.ndarray,
    sent_gyro: np.ndarray,
    sent_force: np.ndarray,
) -> None:
    """Fill packets (n, w, k) with the IMU's readings at their last substeps, and mean forces.

    Args:
        inertial: (13, t, n) attitude, angular velocity, linear and angular acceleration.
        gravity: (3, n) gravity [m/s^2, world].
        tilt: (2, n) or (0, n) tilt of gravity, see `_attitude`.
        imu: (3,) position of the IMU [m, pelvis].
        sent_orientation: output.
        sent_gyro: output.
        sent_force: output.
    """
    _, substeps, num = inertial.shape
    per = substeps // sent_gyro.shape[1]
    for k in range(substeps // per):
        last = (k + 1) * per - 1
        for i in range(num):
            attitude = _attitude(inertial[:, last, i], tilt[:, i])
            for j in range(4):
                sent_orientation[i, k, j] = attitude[j]
            x, y, z = _specific_force(inertial[:, k * per, i], gravity[:, i], imu)
            for t in range(k * per + 1, last + 1):
                more = _specific_force(inertial[:, t, i], gravity[:, i], imu)
                x, y, z = x + more[0], y + more[1], z + more[2]
            for j in range(3):
                sent_gyro[i, k, j] = inertial[4 + j, last, i]
            sent_force[i, k, 0] = x / per
            sent_force[i, k, 1] = y / per
            sent_force[i, k, 2] = z / per


@compiled
def _attitude(inertial: np.ndarray, tilt: np.ndarray) -> tuple[float, float, float, float]:
    """Orientation with w >= 0 in the frame with z against gravity.

    `tilt` has cosine and sine of half the angle about y between that frame and the world; if it is
    empty, the frames are equal.
    """
    w, x, y, z = inertial[0], inertial[1], inertial[2], inertial[3]
    if tilt.size > 0:
        c, s = tilt[0], tilt[1]
        w, x, y, z = c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x
    if w < 0:
        return -w, -x, -y, -z
    return w, x, y, z


@compiled
def _specific_force(
    inertial: np.ndarray, gravity: np.ndarray, imu: np.ndarray
) -> tuple[float, float, float]:
    """Specific force at the IMU in the pelvis frame [m/s^2]."""
    w = inertial[0]
    u = (inertial[1], inertial[2], inertial[3])
    spin = (inertial[4], inertial[5], inertial[6])
    proper = (inertial[7] - gravity[0], inertial[8] - gravity[1], inertial[9] - gravity[2])
    arm = (imu[0], imu[1], imu[2])
    # R^T a = a - 2 w (u x a) + 2 u x (u x a)
    once = _cross(u, proper)
    twice = _cross(u, once)
    tangential = _cross((inertial[10], inertial[11], inertial[12]), arm)
    centripetal = _cross(spin, _cross(spin, arm))
    return (
        proper[0] - 2 * (w * once[0] - twice[0]) + tangential[0] + centripetal[0],
        proper[1] - 2 * (w * once[1] - twice[1]) + tangential[1] + centripetal[1],
        proper[2] - 2 * (w * once[2] - twice[2]) + tangential[2] + centripetal[2],
    )


@compiled
def _cross(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
