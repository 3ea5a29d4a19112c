"""Low level at 2 kHz on a device: drive, delay, encoders and IMU, as Warp kernels.

The laws are those of `aslip.sim.drive`, `aslip.sim.sensors` and MuJoCo's delay, in single
precision; counts and their sums are whole numbers and so exact, filters are double. Scalar laws are
the very functions of the CPU, compiled by Warp. A kernel has a thread for each motor, joint or
robot. MuJoCo Warp delays by times in single precision, which are too coarse after ten seconds; so
torques wait in a ring here.
"""

from __future__ import annotations

import warp as wp

from aslip.sim.drive import motor_limit
from aslip.sim.readings import filter_step
from aslip.sim.warp.functions import device_function
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

_Doubles = wp.array[wp.float64]
_limit = device_function(motor_limit, dict.fromkeys(("torque", "velocity", "slope", "most"), float))
_filter = device_function(
    filter_step,
    dict.fromkeys(("numerator", "denominator", "memory"), _Doubles) | {"value": wp.float64},
)


@wp.func
def _shaft_torque(motors: Motors, i: int, j: int):
    torque = (motors.target[i, j] - motors.position[i, j]) * motors.stiffness[i, j]
    torque -= motors.velocity[i, j] * motors.damping[i, j]
    return _limit(torque / motors.gear[j], motors.velocity[i, j], motors.slope[j], motors.limit[j])


@wp.func
def _read_motor(motors: Motors, i: int, j: int, angle: float, packet: int):
    counted = wp.trunc(angle / motors.step[j])
    total = wp.int32(0)
    # differences to the newest count, as the taps' sum is zero: whole counts would overflow
    for k in range(NUM_TAPS - 1):
        older = motors.count[i, k + 1, j]
        motors.count[i, k, j] = older
        total += OLDEST_FIRST[k] * (older - int(counted))
    motors.count[i, NUM_TAPS - 1, j] = int(counted)
    motors.position[i, j] = counted * motors.step[j]
    motors.velocity[i, j] = float(total) * motors.velocity_step[j]
    if packet >= 0:
        motors.sent_position[i, packet, j] = motors.position[i, j]
        motors.sent_velocity[i, packet, j] = motors.velocity[i, j]


@wp.kernel
def drive_motors(
    motors: Motors, qpos: wp.array2d[float], halves: int, packet: int, ctrl: wp.array2d[float]
):
    """Compute torques from the last readings, then read the motors' encoders.

    With two halves, a physics step applies the mean torque of two substeps.
    """
    i, j = wp.tid()
    torque = _shaft_torque(motors, i, j)
    _read_motor(motors, i, j, qpos[i, motors.qpos[j]], packet)
    if halves == 2:
        torque = 0.5 * (torque + _shaft_torque(motors, i, j))
    tick = motors.tick[i]
    motors.waiting[i, tick % NUM_RING, j] = torque
    ctrl[i, j] = motors.waiting[i, (tick - motors.delay[i] + NUM_RING) % NUM_RING, j]


@wp.kernel
def read_motors(
    motors: Motors, qpos: wp.array2d[float], qvel: wp.array2d[float], ago: float, packet: int
):
    """Read the motors' encoders at a time `ago` before the state [s]."""
    i, j = wp.tid()
    angle = qpos[i, motors.qpos[j]] - ago * qvel[i, motors.qvel[j]]
    _read_motor(motors, i, j, angle, packet)


@wp.kernel
def read_joints(
    joints: Joints,
    inertial: Inertial,
    gravity: wp.array[wp.vec3],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    ago: float,
    packet: int,
):
    """Read joint encoders at a time `ago` before the state, and the attitude of the state."""
    i, j = wp.tid()
    angle = qpos[i, joints.qpos[j]] - ago * qvel[i, joints.qvel[j]]
    counted = wp.trunc(angle / joints.step[j]) * joints.step[j]
    velocity = _filter(
        joints.numerator, joints.denominator, joints.memory[i, j], wp.float64(counted)
    )
    if packet >= 0:
        joints.sent_position[i, packet, j] = counted
        joints.sent_velocity[i, packet, j] = float(velocity)
    if j == 0:
        read_attitude(inertial, i, qpos, qvel)
        if packet >= 0:
            send_attitude(inertial, i, packet, gravity[i])


@wp.kernel
def add_specific_force(
    motors: Motors,
    inertial: Inertial,
    gravity: wp.array[wp.vec3],
    qacc: wp.array2d[float],
    first: int,
    per_packet: int,
    packet: int,
    steps: int,
):
    """Add a substep's specific force; the packet has the mean. Count physics steps by `steps`."""
    i = wp.tid()
    motors.tick[i] += steps
    force = specific_force(inertial, i, gravity[i], qacc)
    if first == 0:
        force += inertial.force[i]
    inertial.force[i] = force
    if packet >= 0:
        for k in range(3):
            inertial.sent_force[i, packet, k] = force[k] / float(per_packet)


@wp.kernel
def add_loads(
    motors: Motors,
    inertial: Inertial,
    ground_force: wp.array2d[int],
    sensordata: wp.array2d[float],
    qfrc_actuator: wp.array2d[float],
    qvel: wp.array2d[float],
    qacc: wp.array2d[float],
    first: int,
    share: float,
):
    """Add a physics step's forces of the floor and powers of the motors to means and maxima."""
    i = wp.tid()
    kept = 1.0 - float(first)
    for foot in range(2):
        for k in range(3):
            force = sensordata[i, ground_force[foot, k]]
            inertial.ground[i, foot, k] = kept * inertial.ground[i, foot, k] + share * force
        up = sensordata[i, ground_force[foot, 2]]
        inertial.largest[i, foot] = wp.max(kept * inertial.largest[i, foot], up)
    for j in range(motors.qvel.shape[0]):
        torque = qfrc_actuator[i, motors.qvel[j]]
        power = wp.max(torque * qvel[i, motors.qvel[j]], 0.0)
        inertial.torque[i, motors.qvel[j]] = torque
        inertial.power[i, j] = kept * inertial.power[i, j] + share * power
    for k in range(6):
        inertial.acceleration[i, k] = qacc[i, k]


@wp.kernel
def push_pelvis(push: wp.array2d[float], pelvis: int, xfrc: wp.array2d[wp.spatial_vector]):
    """Apply forces (n, 3) at the pelvis during the period [N, world]."""
    i = wp.tid()
    xfrc[i, pelvis] = wp.spatial_vector(push[i, 0], push[i, 1], push[i, 2], 0.0, 0.0, 0.0)


@wp.kernel
def record(
    robot: wp.array[int],
    places: wp.array2d[int],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    torque: wp.array2d[float],
    sensordata: wp.array2d[float],
    substep: int,
    watched: wp.array2d[float],
):
    """Write numbers of the watched robot, from arrays and columns of `places`; -1 is nobody."""
    k = wp.tid()
    i = robot[0]
    if i < 0:
        return
    array, column = places[k, 0], places[k, 1]
    value = float(0.0)
    if array == 0:
        value = qpos[i, column]
    elif array == 1:
        value = qvel[i, column]
    elif array == 2:
        value = torque[i, column]
    else:
        value = sensordata[i, column]
    watched[substep, k] = value
