"""Low level at 2 kHz on a device: drive, delay, encoders and IMU, as Warp kernels.

The laws are those of `aslip.sim.drive`, `aslip.sim.sensors` and MuJoCo's delay, in single
precision; counts and their sums are whole numbers and so exact, filters are double. Scalar laws are
the very functions of the CPU, compiled by Warp. A kernel has a thread for each motor, joint or
robot. MuJoCo Warp delays by times in single precision, which are too coarse after ten seconds; so
torques wait in a ring here.
"""

from __future__ import annotations

from typing import Final

import warp as wp

from aslip.sim.drive import motor_limit
from aslip.sim.readings import MOTOR_VELOCITY_TAPS, filter_step
from aslip.sim.warp.functions import device_function

wp.set_module_options({"enable_backward": False})

TAPS: Final = len(MOTOR_VELOCITY_TAPS)
RING: Final = 64
"""Physics steps that a torque can wait."""

_TAPS = wp.constant(TAPS)
_RING = wp.constant(RING)
_taps = wp.types.vector(length=TAPS, dtype=wp.int32)
_OLDEST_FIRST = wp.constant(_taps(*(int(tap) for tap in MOTOR_VELOCITY_TAPS[::-1])))


_Doubles = wp.array[wp.float64]
_limit = device_function(motor_limit, dict.fromkeys(("torque", "velocity", "slope", "most"), float))
_filter = device_function(
    filter_step,
    dict.fromkeys(("numerator", "denominator", "memory"), _Doubles) | {"value": wp.float64},
)


@wp.struct
class Motors:
    """Motors of n robots with their encoders."""

    qpos: wp.array[int]
    qvel: wp.array[int]
    gear: wp.array[float]
    slope: wp.array[float]
    limit: wp.array[float]
    step: wp.array[float]  # joint angle of one count [rad]
    velocity_step: wp.array[float]
    stiffness: wp.array2d[float]
    damping: wp.array2d[float]
    target: wp.array2d[float]
    delay: wp.array[int]  # physics steps
    tick: wp.array[int]  # physics steps since the reset
    waiting: wp.array3d[float]  # (n, RING, m) torques
    count: wp.array3d[int]  # (n, TAPS, m), oldest first
    position: wp.array2d[float]
    velocity: wp.array2d[float]
    sent_position: wp.array3d[float]  # (n, packets, m)
    sent_velocity: wp.array3d[float]


@wp.struct
class Joints:
    """Joint encoders of n robots."""

    qpos: wp.array[int]
    qvel: wp.array[int]
    step: wp.array[float]
    numerator: wp.array[wp.float64]
    denominator: wp.array[wp.float64]
    constant: wp.array[wp.float64]  # memory after a constant angle of one
    ramp: wp.array[wp.float64]  # memory at angle zero of a ramp of 1 rad/s
    memory: wp.array3d[wp.float64]  # (n, joints, order)
    ramp_gain: float
    sent_position: wp.array3d[float]
    sent_velocity: wp.array3d[float]


@wp.struct
class Inertial:
    """IMU of n robots, and means over a policy period."""

    site: wp.vec3
    attitude: wp.array[wp.quat]  # w last, as Warp has it
    spin: wp.array[wp.vec3]
    force: wp.array[wp.vec3]  # sum since the last packet
    sent_orientation: wp.array3d[float]
    sent_gyro: wp.array3d[float]
    sent_force: wp.array3d[float]
    acceleration: wp.array2d[float]  # (n, 6) of the pelvis, of the last physics step
    torque: wp.array2d[float]  # (n, v) of the last physics step, at the joints
    ground: wp.array3d[float]  # (n, 2, 3)
    largest: wp.array2d[float]  # (n, 2)
    power: wp.array2d[float]  # (n, m)


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
    for k in range(_TAPS - 1):
        older = motors.count[i, k + 1, j]
        motors.count[i, k, j] = older
        total += _OLDEST_FIRST[k] * (older - int(counted))
    motors.count[i, _TAPS - 1, j] = int(counted)
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
    motors.waiting[i, tick % _RING, j] = torque
    ctrl[i, j] = motors.waiting[i, (tick - motors.delay[i] + _RING) % _RING, j]


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
        inertial.attitude[i] = wp.quat(qpos[i, 4], qpos[i, 5], qpos[i, 6], qpos[i, 3])
        inertial.spin[i] = wp.vec3(qvel[i, 3], qvel[i, 4], qvel[i, 5])
        if packet >= 0:
            _send_attitude(inertial, i, packet, gravity[i % gravity.shape[0]])


@wp.func
def _send_attitude(inertial: Inertial, i: int, packet: int, gravity: wp.vec3):
    """Send the attitude in the frame with z against gravity, and the angular velocity."""
    half = wp.atan2(gravity[0], -gravity[2]) / 2.0
    q = wp.quat(0.0, wp.sin(half), 0.0, wp.cos(half)) * inertial.attitude[i]
    sign = wp.where(q[3] < 0.0, -1.0, 1.0)
    inertial.sent_orientation[i, packet, 0] = sign * q[3]
    for k in range(3):
        inertial.sent_orientation[i, packet, k + 1] = sign * q[k]
        inertial.sent_gyro[i, packet, k] = inertial.spin[i][k]


@wp.func
def _specific_force(
    inertial: Inertial, i: int, gravity: wp.vec3, linear: wp.vec3, angular: wp.vec3
):
    """Specific force at the IMU [m/s^2, pelvis]."""
    proper = wp.quat_rotate_inv(inertial.attitude[i], linear - gravity)
    spin = inertial.spin[i]
    arm = inertial.site
    return proper + wp.cross(angular, arm) + wp.cross(spin, wp.cross(spin, arm))


@wp.kernel
def feel(
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
    linear = wp.vec3(qacc[i, 0], qacc[i, 1], qacc[i, 2])
    angular = wp.vec3(qacc[i, 3], qacc[i, 4], qacc[i, 5])
    force = _specific_force(inertial, i, gravity[i % gravity.shape[0]], linear, angular)
    if first == 0:
        force += inertial.force[i]
    inertial.force[i] = force
    if packet >= 0:
        for k in range(3):
            inertial.sent_force[i, packet, k] = force[k] / float(per_packet)


@wp.kernel
def weigh(
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
    for k in range(_TAPS):
        angle = qpos[i, motors.qpos[j]] - float(_TAPS - k) * timestep * velocity
        motors.count[i, k, j] = int(wp.trunc(angle / motors.step[j]))
    # the last reading again, from the counts
    newest = motors.count[i, _TAPS - 1, j]
    total = wp.int32(0)
    for k in range(_TAPS):
        total += _OLDEST_FIRST[k] * (motors.count[i, k, j] - newest)
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
    world = gravity[i % gravity.shape[0]]
    inertial.attitude[i] = wp.quat(qpos[i, 4], qpos[i, 5], qpos[i, 6], qpos[i, 3])
    inertial.spin[i] = wp.vec3(qvel[i, 3], qvel[i, 4], qvel[i, 5])
    linear = wp.vec3(qacc[i, 0], qacc[i, 1], qacc[i, 2])
    angular = wp.vec3(qacc[i, 3], qacc[i, 4], qacc[i, 5])
    force = _specific_force(inertial, i, world, linear, angular)
    for packet in range(inertial.sent_gyro.shape[1]):
        _send_attitude(inertial, i, packet, world)
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
        for slot in range(_RING):
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
