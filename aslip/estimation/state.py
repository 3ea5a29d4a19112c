"""Memory and result of the state estimator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from aslip.errors import ShapeError
from aslip.estimation.filter import Belief
from aslip.estimation.packets import PacketMemory
from aslip.robot import CASSIE, Robot
from aslip.robot.rotation import cross


@dataclass
class Tracking:
    """Memory of n robots between packets."""

    belief: Belief
    packets: PacketMemory
    angular_acceleration: np.ndarray
    """(n, 3) between the last two readings of the gyro [rad/s^2, pelvis]."""
    heading: np.ndarray
    """(n,) yaw, in the frame of the IMU's attitude, that is straight ahead for the robot [rad]."""

    def to_rows(self) -> np.ndarray:
        """Write the memory as numbers, (n, `tracking_size`)."""
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
        """Read copies of rows that `to_rows` wrote.

        Raises:
            ShapeError: the rows have another length.
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
    """Numbers in a robot's row of a `Tracking`."""
    return sum(_sizes(robot))


def _sizes(robot: Robot) -> tuple[int, ...]:
    """Numbers of each entry in a row."""
    return (3 * 5, 3 * 5 * 5, 2 * 3, 2, 2, 1, robot.packet_size, 1, 1, 4, 3, 1)


@dataclass(frozen=True)
class Estimate:
    """State of n robots after their last packet.

    The heading frame has z up against gravity, x along the robot's heading, and its origin on the
    ground where the pelvis was at the start.
    """

    height: np.ndarray
    """(n, 1) of the pelvis above the ground [m]."""
    orientation: np.ndarray
    """(n, 4) pelvis to heading frame, unit, wxyz with w >= 0."""
    velocity: np.ndarray
    """(n, 3) of the pelvis [m/s, heading frame]."""
    angular_velocity: np.ndarray
    """(n, 3) [rad/s, pelvis]."""
    acceleration: np.ndarray
    """(n, 3) of the pelvis' origin, without gravity [m/s^2, pelvis]."""
    motor_position: np.ndarray
    """(n, 10) [rad]."""
    motor_velocity: np.ndarray
    """(n, 10) [rad/s]."""
    joint_position: np.ndarray
    """(n, 6) [rad]."""
    joint_velocity: np.ndarray
    """(n, 6) [rad/s]."""
    position: np.ndarray
    """(n, 3) of the pelvis, its height above the ground below it [m, heading frame]."""
    sole: np.ndarray
    """(n, 2, 3) centres of the axes of the soles' contact capsules from the pelvis [m, heading
    frame]."""
    forward: np.ndarray
    """(n, 2, 3) unit vectors to the toes [heading frame]."""
    left: np.ndarray
    """(n, 2, 3) unit vectors to the left, across the feet [heading frame]."""
    sole_radius: float
    """Of the capsules [m]."""
    contact: np.ndarray
    """(n, 2) bool, the leg's springs say that its foot is loaded."""
    innovation: np.ndarray
    """(n, w, 2, 3) normalised innovation squared by packet, foot and axis; NaN in the air."""
    resting: np.ndarray
    """(n, w, 2) bool, the foot took part in the update."""
    faults: np.ndarray
    """(n, 4) bool, what was wrong with any of the packets; see `FAULTS`."""

    # not every packet's feet are looked at, and a robot has little time
    @cached_property
    def up(self) -> np.ndarray:
        """(n, 2, 3) unit vectors out of the feet, opposite to the soles [heading frame]."""
        return cross(self.forward, self.left)

    @cached_property
    def foot_position(self) -> np.ndarray:
        """(n, 2, 3) sole centres [m, heading frame]."""
        return self.position[:, None] + self.sole - self.sole_radius * self.up

    @cached_property
    def foot_orientation(self) -> np.ndarray:
        """(n, 2, 4) soles to heading frame, wxyz, w >= 0; identity when level with toes along x."""
        frame = np.stack([self.forward, self.left, self.up], axis=-1)
        turn = Rotation.from_matrix(frame.reshape(-1, 3, 3))
        return turn.as_quat(canonical=True, scalar_first=True).reshape(-1, 2, 4)
