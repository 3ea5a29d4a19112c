"""Restarts of robots on a device, as Warp kernels: who diverged, and sensors of the new state."""

from __future__ import annotations

import warp as wp

from aslip.sim.warp.structs import (
    NUM_RING,
    NUM_TAPS,
    OLDEST_FIRST,
    Inertial,
    Joints,
    Motors,
    read_attitude,
    send_attitude,
    specific_force,
)

wp.set_module_options({"enable_backward": False})


@wp.kernel
def settle_motors(
    motors: Motors,
    restarted: wp.array[wp.bool],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    timestep: float,
):
    """Let motor encoders of restarted robots have read a constant velocity."""
    i, j = wp.tid()
    if not restarted[i]:
        return
    velocity = qvel[i, motors.qvel[j]]
    for k in range(NUM_TAPS):
        angle = qpos[i, motors.qpos[j]] - float(NUM_TAPS - k) * timestep * velocity
        motors.count[i, k, j] = int(wp.trunc(angle / motors.step[j]))
    # the last reading again, from the counts
    newest = motors.count[i, NUM_TAPS - 1, j]
    total = wp.int32(0)
    for k in range(NUM_TAPS):
        total += OLDEST_FIRST[k] * (motors.count[i, k, j] - newest)
    motors.position[i, j] = float(newest) * motors.step[j]
    motors.velocity[i, j] = float(total) * motors.velocity_step[j]
    for packet in range(motors.sent_position.shape[1]):
        motors.sent_position[i, packet, j] = motors.position[i, j]
        motors.sent_velocity[i, packet, j] = motors.velocity[i, j]


@wp.kernel
def settle_joints(
    joints: Joints,
    restarted: wp.array[wp.bool],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    timestep: float,
):
    """Let joint encoders of restarted robots have read a constant velocity."""
    i, j = wp.tid()
    if not restarted[i]:
        return
    velocity = qvel[i, joints.qvel[j]]
    angle = qpos[i, joints.qpos[j]] - timestep * velocity
    counted = wp.trunc(angle / joints.step[j]) * joints.step[j]
    for k in range(joints.memory.shape[2]):
        constant = joints.constant[k] * wp.float64(counted)
        joints.memory[i, j, k] = constant + joints.ramp[k] * wp.float64(velocity)
    for packet in range(joints.sent_position.shape[1]):
        joints.sent_position[i, packet, j] = counted
        joints.sent_velocity[i, packet, j] = joints.ramp_gain * velocity


@wp.kernel
def settle_inertial(
    motors: Motors,
    inertial: Inertial,
    restarted: wp.array[wp.bool],
    gravity: wp.array[wp.vec3],
    ground_force: wp.array2d[int],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    qacc: wp.array2d[float],
    qfrc_actuator: wp.array2d[float],
    sensordata: wp.array2d[float],
):
    """Start IMU and means of restarted robots from their present state."""
    i = wp.tid()
    if not restarted[i]:
        return
    read_attitude(inertial, i, qpos, qvel)
    force = specific_force(inertial, i, gravity[i], qacc)
    for packet in range(inertial.sent_gyro.shape[1]):
        send_attitude(inertial, i, packet, gravity[i])
        for k in range(3):
            inertial.sent_force[i, packet, k] = force[k]
    for foot in range(2):
        for k in range(3):
            inertial.ground[i, foot, k] = sensordata[i, ground_force[foot, k]]
        inertial.largest[i, foot] = inertial.ground[i, foot, 2]
    for j in range(motors.qvel.shape[0]):
        inertial.torque[i, motors.qvel[j]] = qfrc_actuator[i, motors.qvel[j]]
        inertial.power[i, j] = 0.0
    for k in range(6):
        inertial.acceleration[i, k] = qacc[i, k]


@wp.kernel
def restart(
    motors: Motors,
    restarted: wp.array[wp.bool],
    initial_qpos: wp.array2d[float],
    initial_qvel: wp.array2d[float],
    time: wp.array[float],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    warmstart: wp.array2d[float],
    ctrl: wp.array2d[float],
    overflow: wp.array[int],
):
    """Put robots at initial states, without memory of what was before; one row serves all."""
    i = wp.tid()
    if not restarted[i]:
        return
    row = i % initial_qpos.shape[0]
    time[i] = 0.0
    overflow[i] = 0
    motors.tick[i] = 0
    for k in range(qpos.shape[1]):
        qpos[i, k] = initial_qpos[row, k]
    for k in range(qvel.shape[1]):
        qvel[i, k] = initial_qvel[row, k]
        warmstart[i, k] = 0.0
    for j in range(ctrl.shape[1]):
        ctrl[i, j] = 0.0
        for slot in range(NUM_RING):
            motors.waiting[i, slot, j] = 0.0


@wp.kernel
def find_diverged(
    motors: Motors,
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    qacc: wp.array2d[float],
    overflow: wp.array[int],
    largest: float,
    diverged: wp.array[wp.bool],
    overflows: wp.array[int],
):
    """Mark robots whose state is not finite or too large, or whose contacts overflow."""
    i = wp.tid()
    # not (x <= y) holds for NaN, too
    bad = bool(False)
    for k in range(qpos.shape[1]):
        if not (wp.abs(qpos[i, k]) <= largest):
            bad = True
    for k in range(qvel.shape[1]):
        if not (wp.abs(qvel[i, k]) <= largest and wp.abs(qacc[i, k]) <= largest):
            bad = True
    # limits of torques hide targets that are not finite
    for j in range(motors.target.shape[1]):
        if not (wp.abs(motors.target[i, j]) <= largest):
            bad = True
    if overflow[i] != 0:
        overflows[i] += 1
    diverged[i] = bad or overflow[i] != 0
