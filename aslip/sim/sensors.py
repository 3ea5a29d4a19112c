r"""Encoders and IMU at 2 kHz, with the filters and packets of the robot's electronics.

Encoders truncate toward zero to counts of a turn over a power of two; motor encoders are on the
motor side of the gear. Velocities are filtered positions: for a motor by an FIR filter with nine
integer taps (gain 0.9997, delay 0.52 ms), for a joint by an IIR filter (gain 1.0019, delay 4.5 ms,
gain 0.75 at 50 Hz). Encoders and filters are those of the public simulator.

The IMU measures attitude, angular velocity and specific force at its site in the pelvis,

.. math:: f = R^T (\ddot p - g) + \alpha \times r + \omega \times (\omega \times r),

computed here because MuJoCo's own sensor takes a sixth of a physics step. The attitude is that of
the pelvis in a frame with z against gravity, the world frame unless the floor has a slope.

A reading is taken before each physics step, and the PD loop uses the previous reading, as in the
public simulator. A packet every 3 ms has encoders, attitude and angular velocity of that instant,
and the *mean* specific force since the previous packet: inertial units integrate internally, and a
single sample during an impact would not give the change of velocity.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from aslip.robot import CASSIE, Robot
from aslip.sim.readings import (
    MOTOR_VELOCITY_TAPS,
    OLDEST_FIRST,
    fill_encoders,
    fill_imu,
    filter_joints,
    read_encoders,
)

JOINT_VELOCITY_FILTER: Final = (
    12.348 * np.array([1.0, 1.0, -1.0, -1.0]),
    np.array([1.0, -1.7658, 0.79045]),
)
"""Numerator and denominator of the filter from joint angle to velocity (public simulator)."""

_TAPS = len(MOTOR_VELOCITY_TAPS)
_MEMORY_ROWS = _TAPS - 1
_ORDER = max(map(len, JOINT_VELOCITY_FILTER)) - 1

# after quaternion and angular velocity: linear and angular acceleration
_LINEAR, _ANGULAR = slice(7, 10), slice(10, 13)


class Sensors:
    """Sensors of n robots.

    The simulation calls `read` before and `record_acceleration` after every physics step, and
    `finish` after a policy period, before `packets`. A physics step computes only what the PD loop
    needs.

    Args:
        num: number of robots n.
        model: compiled model of the robot; gives gravity and the position of the IMU.
        robot: robot of the model; gives encoders and timing.
    """

    def __init__(self, num: int, model: mujoco.MjModel, robot: Robot = CASSIE) -> None:
        self._indices, self._timestep = robot.indices, robot.physics_timestep
        indices = self._indices
        self._encoder_qpos = np.concatenate([indices.motor_qpos, indices.joint_qpos])
        # joint angle of one count [rad]
        self._motor_step = 2 * np.pi / 2.0**robot.motor_encoder_bits / robot.gear
        self._joint_step = 2 * np.pi / 2.0**robot.joint_encoder_bits
        # joint velocity of one unit of the sum of taps times counts [rad/s]
        self._velocity_step = self._motor_step / np.pi
        self._substeps = robot.substeps
        self._imu = model.site(robot.imu_site).pos.copy()
        self._gravity = np.tile(model.opt.gravity[:, None], num)
        motors, joints = len(robot.motor_names), len(robot.joint_names)
        self._motors = motors
        self._angle = np.zeros((robot.substeps, num, motors + joints))
        # motor counts: the last ones of the previous period, then those of this period
        self._count = np.zeros((_MEMORY_ROWS + robot.substeps, num, motors))
        self._velocity = np.zeros((robot.substeps, num, motors))
        self._joint_memory = np.zeros((_ORDER, num, joints))
        self._inertial = np.zeros((_ANGULAR.stop, robot.substeps, num))
        self._joint_filter = _padded(*JOINT_VELOCITY_FILTER)
        self._constant = _settled(*JOINT_VELOCITY_FILTER)
        self._ramp, self._ramp_gain = _ramp_response(self._timestep)
        self._packets = {
            name: np.zeros((num, robot.sensor_window, size))
            for name, size in robot.packet_sizes.items()
        }
        self.motor_position = np.zeros((num, motors))
        """(n, 10) latest motor positions [rad]."""
        self.motor_velocity = np.zeros((num, motors))
        """(n, 10) latest motor velocities [rad/s]."""
        self.set_gravity(np.arange(num), self._gravity.T)

    def set_gravity(self, ids: np.ndarray, gravity: np.ndarray) -> None:
        """Set the gravity (k, 3) of (k,) robots [m/s^2, world]; y must be zero."""
        self._gravity[:, ids] = gravity.T
        half = np.arctan2(self._gravity[0], -self._gravity[2]) / 2
        # cosine and sine of half the angle that turns the world about y until gravity is down
        sloped = half.any()
        self._tilt = np.stack([np.cos(half), np.sin(half)]) if sloped else np.empty((0, len(half)))

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, qacc: np.ndarray) -> None:
        """Restart the sensors of some robots, as if they had always moved at these velocities.

        The filters start settled. All packets of the window equal the reading one substep before.

        Args:
            ids: (k,) robots.
            qpos: (k, 35) generalised positions.
            qvel: (k, 32) generalised velocities.
            qacc: (k, 32) generalised accelerations.
        """
        at = self._indices
        velocity = qvel[:, at.motor_qvel]
        angle = qpos[:, at.motor_qpos]
        ages = self._timestep * np.arange(_TAPS, 0, -1)
        counts = np.trunc((angle - ages[:, None, None] * velocity) / self._motor_step)
        self._count[:_MEMORY_ROWS, ids] = counts[1:]
        self.motor_position[ids] = counts[-1] * self._motor_step
        # a sum of whole numbers is exact in any order
        velocity = (OLDEST_FIRST @ counts.reshape(_TAPS, -1)).reshape(counts.shape[1:])
        self.motor_velocity[ids] = velocity * self._velocity_step

        joint_velocity = qvel[:, at.joint_qvel]
        joint = qpos[:, at.joint_qpos] - self._timestep * joint_velocity
        # truncated angles: otherwise the filter would see the truncation as a step
        counted = np.trunc(joint / self._joint_step) * self._joint_step
        self._joint_memory[:, ids] = (
            self._constant[:, None, None] * counted + self._ramp[:, None, None] * joint_velocity
        )
        inertial = np.concatenate(
            [
                qpos[:, at.pelvis_orientation],
                qvel[:, at.pelvis_angular_velocity],
                qacc[:, at.pelvis_velocity],
                qacc[:, at.pelvis_angular_velocity],
            ],
            axis=1,
        ).T
        attitude, gyro, force = (np.empty((len(ids), 1, size)) for size in (4, 3, 3))
        # a period of one substep, in arrays as those that the function is compiled for
        now = (
            np.ascontiguousarray(a)
            for a in (inertial[:, None], self._gravity[:, ids], self._tilt[:, ids])
        )
        fill_imu(*now, self._imu, attitude, gyro, force)
        first = {
            "motor_position": self.motor_position[ids],
            "motor_velocity": self.motor_velocity[ids],
            "joint_position": counted,
            "joint_velocity": self._ramp_gain * joint_velocity,
            "orientation": attitude[:, 0],
            "gyro": gyro[:, 0],
            "accelerometer": force[:, 0],
        }
        for name, values in first.items():
            self._packets[name][ids] = values[:, None]

    def read(self, substep: int, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Read encoders and IMU before a physics step, from `qpos` (n, 35) and `qvel` (n, 32)."""
        self.motor_velocity = self._velocity[substep]
        read_encoders(
            qpos, qvel, self._encoder_qpos, self._angle[substep],
            self._count[substep : substep + _TAPS], self.motor_position, self.motor_velocity,
            self._inertial[:, substep], self._motor_step, self._velocity_step,
            self._indices.pelvis_orientation.start, self._indices.pelvis_angular_velocity.start,
        )  # fmt: skip

    def record_acceleration(self, substep: int, qacc: np.ndarray) -> None:
        """Record the accelerations (n, 32) of the state of `read`, after its physics step."""
        at = self._indices
        self._inertial[_LINEAR, substep] = qacc[:, at.pelvis_velocity].T
        self._inertial[_ANGULAR, substep] = qacc[:, at.pelvis_angular_velocity].T

    def finish(self) -> None:
        """Compute the packets of a policy period after its last physics step."""
        joint_angle, sent = self._angle[..., self._motors :], self._packets
        fill_encoders(
            self._count[_MEMORY_ROWS:], self._motor_step, self._velocity,
            sent["motor_position"], sent["motor_velocity"],
            joint_angle, self._joint_step, *self._joint_filter, self._joint_memory,
            sent["joint_position"], sent["joint_velocity"],
        )  # fmt: skip
        fill_imu(
            self._inertial, self._gravity, self._tilt, self._imu,
            sent["orientation"], sent["gyro"], sent["accelerometer"],
        )  # fmt: skip
        self._count[:_MEMORY_ROWS] = self._count[self._substeps :]
        # copy, as the next period overwrites the buffer
        self.motor_velocity = self.motor_velocity.copy()

    def packets(self) -> dict[str, np.ndarray]:
        """Live arrays (n, `Robot.sensor_window`, k) of the last policy period.

        `motor_position` 10, `motor_velocity` 10, `joint_position` 6, `joint_velocity` 6 [rad,
        rad/s]; of the IMU `orientation` 4 (pelvis to world, wxyz, w >= 0), `gyro` 3 [rad/s, pelvis]
        and `accelerometer` 3 [m/s^2, pelvis].
        """
        return self._packets

    def memory(self) -> np.ndarray:
        """(n, k) state of the sensors between policy periods."""
        num = len(self.motor_position)
        parts = (
            self._count[:_MEMORY_ROWS].swapaxes(0, 1),
            self._joint_memory.swapaxes(0, 1),
            self.motor_position,
            self.motor_velocity,
        )
        return np.concatenate([part.reshape(num, -1) for part in parts], axis=1)

    @property
    def memory_size(self) -> int:
        """Length of one robot's row in `memory`."""
        return (_MEMORY_ROWS + 2) * self._motors + self._joint_memory[:, 0].size

    def set_memory(self, rows: np.ndarray) -> None:
        """Restore a result of `memory`."""
        num, motors = self.motor_position.shape
        ends = np.cumsum([_MEMORY_ROWS * motors, self._joint_memory[:, 0].size, motors])
        count, joint, position, velocity = np.split(rows, ends, axis=1)
        self._count[:_MEMORY_ROWS] = count.reshape(num, _MEMORY_ROWS, motors).swapaxes(0, 1)
        self._joint_memory[:] = joint.reshape(num, _ORDER, -1).swapaxes(0, 1)
        self.motor_position[:], self.motor_velocity[:] = position, velocity


def _padded(numerator: np.ndarray, denominator: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients, padded with zeros to equal lengths."""
    size = max(len(numerator), len(denominator))
    b, a = (np.pad(taps, (0, size - len(taps))) for taps in (numerator, denominator))
    return b, a


def _settled(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    """Memory of a filter with constant input one, like `scipy.signal.lfilter_zi`."""
    b, a = _padded(numerator, denominator)
    # memory' = shift(memory) - a memory[0] + (b - a b[0]) x, and settled for x = 1
    step = np.eye(len(b) - 1, k=1)
    step[:, 0] -= a[1:]
    return np.linalg.solve(np.eye(len(b) - 1) - step, b[1:] - a[1:] * b[0])


def _ramp_response(timestep: float) -> tuple[np.ndarray, float]:
    """Memory and output of the joint filter at angle zero of a ramp of 1 rad/s."""
    ramp = (timestep * np.arange(-1000.0, 1.0))[:, None, None]
    memory = _settled(*JOINT_VELOCITY_FILTER)[:, None, None] * ramp[0]
    output = np.empty_like(ramp)
    filter_joints(*_padded(*JOINT_VELOCITY_FILTER), ramp, memory, output)
    return memory[:, 0, 0], float(output[-1, 0, 0])


def filter_start(timestep: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Joint filter: numerator, denominator, memory after a constant and a ramp, gain of a ramp."""
    ramp, gain = _ramp_response(timestep)
    return *_padded(*JOINT_VELOCITY_FILTER), _settled(*JOINT_VELOCITY_FILTER), ramp, gain
