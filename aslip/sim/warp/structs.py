"""Arrays of the low level on a device, in structs that kernels take, and laws of the IMU."""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
import warp as wp

from aslip.robot import Robot
from aslip.sim.readings import MOTOR_VELOCITY_TAPS
from aslip.sim.sensors import filter_start

wp.set_module_options({"enable_backward": False})

TAPS: Final = len(MOTOR_VELOCITY_TAPS)
RING: Final = 64
"""Physics steps that a torque can wait."""

# as constants of kernels
NUM_TAPS = wp.constant(TAPS)
NUM_RING = wp.constant(RING)
_Taps = wp.types.vector(length=TAPS, dtype=wp.int32)
OLDEST_FIRST = wp.constant(_Taps(*(int(tap) for tap in MOTOR_VELOCITY_TAPS[::-1])))


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


def make_motors(num: int, model: mujoco.MjModel, robot: Robot) -> Any:
    """`Motors` of n robots on the current device."""
    at, motors = robot.indices, len(robot.motor_names)
    step = 2 * np.pi / 2.0**robot.motor_encoder_bits / robot.gear
    return _struct(
        Motors,
        qpos=at.motor_qpos.astype(np.int32),
        qvel=at.motor_qvel.astype(np.int32),
        gear=robot.gear,
        slope=-2.0 / (robot.no_load_speed / robot.gear),
        limit=robot.torque_limit,
        step=step,
        velocity_step=step / np.pi,
        stiffness=np.tile(robot.stiffness, (num, 1)),
        damping=np.tile(robot.damping, (num, 1)),
        target=np.zeros((num, motors)),
        delay=np.full(num, round(robot.torque_delay / model.opt.timestep), np.int32),
        tick=np.zeros(num, np.int32),
        waiting=np.zeros((num, RING, motors)),
        count=np.zeros((num, TAPS, motors), np.int32),
        position=np.zeros((num, motors)),
        velocity=np.zeros((num, motors)),
        **_sent(num, robot, position=motors, velocity=motors),
    )


def make_joints(num: int, robot: Robot) -> Any:
    """`Joints` of n robots on the current device."""
    at, joints = robot.indices, len(robot.joint_names)
    numerator, denominator, constant, ramp, gain = filter_start(robot.physics_timestep)
    double = {"numerator": numerator, "denominator": denominator, "constant": constant}
    double |= {"ramp": ramp, "memory": np.zeros((num, joints, len(ramp)))}
    return _struct(
        Joints,
        qpos=at.joint_qpos.astype(np.int32),
        qvel=at.joint_qvel.astype(np.int32),
        step=2 * np.pi / 2.0**robot.joint_encoder_bits,
        ramp_gain=gain,
        **{name: wp.array(value, dtype=wp.float64) for name, value in double.items()},
        **_sent(num, robot, position=joints, velocity=joints),
    )


def make_inertial(num: int, model: mujoco.MjModel, robot: Robot) -> Any:
    """`Inertial` of n robots on the current device."""
    return _struct(
        Inertial,
        site=wp.vec3(*model.site(robot.imu_site).pos),
        attitude=wp.zeros(num, dtype=wp.quat),
        spin=wp.zeros(num, dtype=wp.vec3),
        force=wp.zeros(num, dtype=wp.vec3),
        acceleration=np.zeros((num, 6)),
        torque=np.zeros((num, robot.indices.num_qvel)),
        ground=np.zeros((num, 2, 3)),
        largest=np.zeros((num, 2)),
        power=np.zeros((num, len(robot.motor_names))),
        **_sent(num, robot, orientation=4, gyro=3, force=3),
    )


def _sent(num: int, robot: Robot, **sizes: int) -> dict[str, wp.array]:
    """Packets of a policy period, by name with their size."""
    shape = num, robot.sensor_window
    return {f"sent_{n}": wp.zeros((*shape, size), dtype=float) for n, size in sizes.items()}


def _struct(kind: Any, **values: Any) -> Any:
    """Struct of Warp with arrays on the current device."""
    struct = kind()
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            whole = np.issubdtype(value.dtype, np.integer)
            value = wp.array(value, dtype=int if whole else float)
        setattr(struct, name, value)
    return struct


@wp.func
def send_attitude(inertial: Inertial, i: int, packet: int, gravity: wp.vec3):
    """Send the attitude in the frame with z against gravity, and the angular velocity."""
    half = wp.atan2(gravity[0], -gravity[2]) / 2.0
    q = wp.quat(0.0, wp.sin(half), 0.0, wp.cos(half)) * inertial.attitude[i]
    sign = wp.where(q[3] < 0.0, -1.0, 1.0)
    inertial.sent_orientation[i, packet, 0] = sign * q[3]
    for k in range(3):
        inertial.sent_orientation[i, packet, k + 1] = sign * q[k]
        inertial.sent_gyro[i, packet, k] = inertial.spin[i][k]


@wp.func
def read_attitude(inertial: Inertial, i: int, qpos: wp.array2d[float], qvel: wp.array2d[float]):
    """Read attitude and angular velocity of the pelvis."""
    inertial.attitude[i] = wp.quat(qpos[i, 4], qpos[i, 5], qpos[i, 6], qpos[i, 3])
    inertial.spin[i] = wp.vec3(qvel[i, 3], qvel[i, 4], qvel[i, 5])


@wp.func
def specific_force(inertial: Inertial, i: int, gravity: wp.vec3, qacc: wp.array2d[float]):
    """Specific force at the IMU [m/s^2, pelvis]."""
    linear = wp.vec3(qacc[i, 0], qacc[i, 1], qacc[i, 2])
    angular = wp.vec3(qacc[i, 3], qacc[i, 4], qacc[i, 5])
    proper = wp.quat_rotate_inv(inertial.attitude[i], linear - gravity)
    spin = inertial.spin[i]
    arm = inertial.site
    return proper + wp.cross(angular, arm) + wp.cross(spin, wp.cross(spin, arm))
