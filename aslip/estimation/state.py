"""Memory and result of the state estimator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aslip.errors import ShapeError
from aslip.estimation.filter import Belief
from aslip.estimation.packets import PacketMemory
from aslip.robot import CASSIE, Robot
from aslip.robot.rotation import cross, matrix_to_quaternion


@dataclass
class Tracking:
    """Memory of n robots between packets."""

    belief: Belief
    packets: PacketMemory
    angular_acceleration: np.ndarray
    """(n, 3) change rate between the last two gyro readings [rad/s^2, pelvis]."""
    heading: np.ndarray
    """(n,) yaw of the straight-ahead direction in the frame of the IMU's attitude [rad]."""

    def to_rows(self) -> np.ndarray:
        """Convert the memory to an array (n, `tracking_size`)."""
        belief, packets = self.belief, self.packets
        fields = (
            belief.mean, belief.covariance, belief.half_sole, belief.loaded, belief.resting,
            belief.adrift, packets.reading, packets.jumps, packets.repeats, packets.age,
            self.angular_acceleration, self.heading,
        )  # fmt: skip
        num = len(packets.reading)
        return np.concatenate([field.reshape(num, -1) for field in fields], axis=1)

    @classmethod
    def from_rows(cls, rows: np.ndarray, robot: Robot = CASSIE) -> Tracking:
        """Restore the memory from an array that `to_rows` returned; copies.

        Raises:
            ShapeError: the rows have the wrong length.
        """
        size = tracking_size(robot)
        if rows.ndim != 2 or rows.shape[1] != size:
            raise ShapeError(f"rows must have the shape (n, {size}), got {rows.shape}")
        num = len(rows)
        (
            mean, covariance, half_sole, loaded, resting, adrift, reading, jumps, repeats, age,
            angular_acceleration, heading,
        ) = np.split(rows.copy(), np.cumsum(_sizes(robot))[:-1], axis=1)  # fmt: skip
        belief = Belief(
            mean=mean.reshape(num, 3, 5).copy(),
            covariance=covariance.reshape(num, 3, 5, 5).copy(),
            half_sole=half_sole.reshape(num, 2, 3).copy(),
            loaded=loaded != 0,
            resting=resting != 0,
            adrift=adrift[:, 0].copy(),
            innovation=np.full((num, 2, 3), np.nan),
        )
        packets = PacketMemory(reading, jumps[:, 0], repeats[:, 0], age)
        return cls(belief, packets, angular_acceleration, heading[:, 0])


def tracking_size(robot: Robot = CASSIE) -> int:
    """Length of a robot's row in `Tracking.to_rows`."""
    return sum(_sizes(robot))


def _sizes(robot: Robot) -> tuple[int, ...]:
    """Length of each field in a row."""
    return (3 * 5, 3 * 5 * 5, 2 * 3, 2, 2, 1, robot.packet_size, 1, 1, 4, 3, 1)


@dataclass(frozen=True)
class Estimate:
    """State of n robots after their last packet.

    The heading frame has z up against gravity, x along the robot's heading, and its origin on the
    ground where the pelvis was at the start.
    """

    height: np.ndarray
    """(n, 1) height of the pelvis above the ground [m]."""
    orientation: np.ndarray
    """(n, 4) pelvis to heading frame, unit, wxyz with w >= 0."""
    velocity: np.ndarray
    """(n, 3) velocity of the pelvis [m/s, heading frame]."""
    angular_velocity: np.ndarray
    """(n, 3) angular velocity of the pelvis [rad/s, pelvis]."""
    acceleration: np.ndarray
    """(n, 3) acceleration of the pelvis' origin, without gravity [m/s^2, pelvis]."""
    motor_position: np.ndarray
    """(n, 10) angles of the driven joints [rad]."""
    motor_velocity: np.ndarray
    """(n, 10) velocities of the driven joints [rad/s]."""
    joint_position: np.ndarray
    """(n, 6) angles of the joints with encoders [rad]."""
    joint_velocity: np.ndarray
    """(n, 6) velocities of the joints with encoders [rad/s]."""
    position: np.ndarray
    """(n, 3) position of the pelvis; z is `height` [m, heading frame]."""
    sole: np.ndarray
    """(n, 2, 3) centres of the soles' axes relative to the pelvis [m, heading frame]."""
    forward: np.ndarray
    """(n, 2, 3) unit vectors from heel to toes [heading frame]."""
    left: np.ndarray
    """(n, 2, 3) unit vectors to the left of the feet [heading frame]."""
    sole_radius: float
    """Radius of the soles' contact capsules [m]."""
    contact: np.ndarray
    """(n, 2) bool, contact by the springs of the leg."""
    innovation: np.ndarray
    """(n, w, 2, 3) normalised innovation squared by packet, foot and axis; NaN without contact."""
    resting: np.ndarray
    """(n, w, 2) bool, foot at rest: a measurement of the filter."""
    faults: np.ndarray
    """(n, 4) bool, `FAULTS` of any packet of the window."""

    # computed on demand, to save time on a robot
    @cached_property
    def up(self) -> np.ndarray:
        """(n, 2, 3) unit vectors up from the soles [heading frame]."""
        return cross(self.forward, self.left)

    @cached_property
    def foot_position(self) -> np.ndarray:
        """(n, 2, 3) sole centres [m, heading frame]."""
        return self.position[:, None] + self.sole - self.sole_radius * self.up

    @cached_property
    def foot_orientation(self) -> np.ndarray:
        """(n, 2, 4) soles to heading frame, wxyz, w >= 0; identity if level with toes along x."""
        frame = np.stack([self.forward, self.left, self.up], axis=-1)
        return matrix_to_quaternion(frame)
