"""Memory and result of the state estimator."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

from aslip.base.arrays import Array, copied, namespace
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
    angular_acceleration: Array
    """(n, 3) change rate between the last two gyro readings [rad/s^2, pelvis]."""
    heading: Array
    """(n,) yaw of the straight-ahead direction in the frame of the IMU's attitude [rad]."""

    def to_rows(self) -> Array:
        """Convert the memory to an array (n, `tracking_size`)."""
        belief, packets = self.belief, self.packets
        fields = (
            belief.mean, belief.covariance, belief.half_sole, belief.loaded, belief.resting,
            belief.adrift, packets.reading, packets.jumps, packets.repeats, packets.age,
            self.angular_acceleration, self.heading,
        )  # fmt: skip
        num = len(packets.reading)
        xp = namespace(packets.reading)
        return xp.concatenate([field.reshape(num, -1) for field in fields], axis=1)

    @classmethod
    def from_rows(cls, rows: Array, robot: Robot = CASSIE) -> Tracking:
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
        ) = _split(copied(rows), _sizes(robot))  # fmt: skip
        belief = Belief(
            mean=copied(mean.reshape(num, 3, 5)),
            covariance=copied(covariance.reshape(num, 3, 5, 5)),
            half_sole=copied(half_sole.reshape(num, 2, 3)),
            loaded=loaded != 0,
            resting=resting != 0,
            adrift=copied(adrift[:, 0]),
            innovation=half_sole.reshape(num, 2, 3) * math.nan,
        )
        packets = PacketMemory(reading, jumps[:, 0], repeats[:, 0], age)
        return cls(belief, packets, angular_acceleration, heading[:, 0])


def _split(rows: Array, sizes: tuple[int, ...]) -> list[Array]:
    ends = list(itertools.accumulate(sizes))
    return [rows[:, end - size : end] for end, size in zip(ends, sizes, strict=True)]


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

    height: Array
    """(n, 1) height of the pelvis above the ground; of any height, above the loaded feet [m]."""
    orientation: Array
    """(n, 4) pelvis to heading frame, unit, wxyz with w >= 0."""
    velocity: Array
    """(n, 3) velocity of the pelvis [m/s, heading frame]."""
    angular_velocity: Array
    """(n, 3) angular velocity of the pelvis [rad/s, pelvis]."""
    acceleration: Array
    """(n, 3) acceleration of the pelvis' origin, without gravity [m/s^2, pelvis]."""
    motor_position: Array
    """(n, 10) angles of the driven joints [rad]."""
    motor_velocity: Array
    """(n, 10) velocities of the driven joints [rad/s]."""
    joint_position: Array
    """(n, 6) angles of the joints with encoders [rad]."""
    joint_velocity: Array
    """(n, 6) velocities of the joints with encoders [rad/s]."""
    position: Array
    """(n, 3) position of the pelvis; on level ground z is `height` [m, heading frame]."""
    sole: Array
    """(n, 2, 3) centres of the soles' axes relative to the pelvis [m, heading frame]."""
    forward: Array
    """(n, 2, 3) unit vectors from heel to toes [heading frame]."""
    left: Array
    """(n, 2, 3) unit vectors to the left of the feet [heading frame]."""
    sole_radius: float
    """Radius of the soles' contact capsules [m]."""
    contact: Array
    """(n, 2) bool, contact by the springs of the leg."""
    innovation: Array
    """(n, w, 2, 3) normalised innovation squared by packet, foot and axis; NaN without contact."""
    resting: Array
    """(n, w, 2) bool, foot at rest: a measurement of the filter."""
    faults: Array
    """(n, 4) bool, `FAULTS` of any packet of the window."""

    # computed on demand, to save time on a robot
    @cached_property
    def up(self) -> Array:
        """(n, 2, 3) unit vectors up from the soles [heading frame]."""
        return cross(self.forward, self.left)

    @cached_property
    def foot_position(self) -> Array:
        """(n, 2, 3) sole centres [m, heading frame]."""
        return self.position[:, None] + self.sole - self.sole_radius * self.up

    @cached_property
    def foot_orientation(self) -> Array:
        """(n, 2, 4) soles to heading frame, wxyz, w >= 0; identity if level with toes along x."""
        frame = namespace(self.forward).stack([self.forward, self.left, self.up], axis=-1)
        return matrix_to_quaternion(frame)
