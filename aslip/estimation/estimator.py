"""From sensor packets to the state of the robot, for many robots or a stream from one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from aslip.errors import ConfigurationError, ShapeError
from aslip.estimation.filter import Belief, ContactFilter, FilterNoise, Motion, P, V
from aslip.estimation.legs import FORCE, HEEL, LATERAL, TOE, LegKinematics
from aslip.estimation.packets import PACKET_SIZE, SLICES, PacketMemory, Screen, Screened, join
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.robot.model import load_model
from aslip.robot.rotation import (
    cross,
    normalize,
    orientation_to_heading,
    vector_to_heading,
    yaw,
)

# standard deviation [m/s^2] of the mean over 3 ms of an acceleration that had to be made up
_DOUBT = 5.0
# [s] step to differentiate the legs' kinematics by
_DIFFERENCE = 1e-5


@dataclass
class Tracking:
    """All that is remembered of n robots between packets."""

    belief: Belief
    packets: PacketMemory
    angular_acceleration: np.ndarray
    """(n, 3) between the last two readings of the gyro [rad/s^2, pelvis]."""
    heading: np.ndarray
    """(n,) yaw, in the frame of the IMU's attitude, that is straight ahead for the robot [rad]."""

    def to_rows(self) -> np.ndarray:
        """(n, `TRACKING_SIZE`) all of it as numbers."""
        belief, packets = self.belief, self.packets
        fields = (
            belief.mean, belief.covariance, belief.half_sole, belief.loaded, belief.resting,
            belief.adrift, packets.reading, packets.jumps, packets.repeats, packets.age,
            self.angular_acceleration, self.heading,
        )  # fmt: skip
        num = len(packets.reading)
        return np.concatenate([field.reshape(num, -1) for field in fields], axis=1)

    @classmethod
    def from_rows(cls, rows: np.ndarray) -> Tracking:
        """What `to_rows` wrote; copies.

        Raises:
            ShapeError: the rows have another length.
        """
        if rows.ndim != 2 or rows.shape[1] != TRACKING_SIZE:
            raise ShapeError(f"rows must have the shape (n, {TRACKING_SIZE}), got {rows.shape}")
        num = len(rows)
        (
            mean, covariance, half_sole, loaded, resting, adrift, reading, jumps, repeats, age,
            angular_acceleration, heading,
        ) = np.split(rows.copy(), _TRACKING_ENDS, axis=1)  # fmt: skip
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


_TRACKING_SIZES = (3 * 5, 3 * 5 * 5, 2 * 3, 2, 2, 1, PACKET_SIZE, 1, 1, 4, 3, 1)
_TRACKING_ENDS = np.cumsum(_TRACKING_SIZES)[:-1]

TRACKING_SIZE = sum(_TRACKING_SIZES)
"""Numbers to remember of a robot between packets."""


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


class StateEstimator:
    """Pelvis, legs and feet of n robots from packets of their sensors.

    It holds no state: what it remembers of the robots is a `Tracking`. As on a robot:

        estimator = StateEstimator()
        tracking, estimate = estimator.start(packet)
        while True:
            estimate = estimator.update(tracking, packet)

    A packet is a mapping of the entries of `aslip.robot.Robot.packet_sizes`, or those joined to
    an array. Windows of packets of several robots, oldest first, have the leading shape (n, w).
    The accelerometer's value is the mean since the packet before.

    A packet with NaN, with values out of range, with a spike of the IMU, or of an IMU that is
    frozen, is recognised (`Estimate.faults`), and the channels it lacks are bridged: by their last
    good readings, more doubt about the acceleration, and no measurement with that leg. An IMU
    slower than the packets, down to 200 Hz, is no fault. `None` is a packet that got lost. Robots
    do not touch each other.

    Args:
        model: the robot; `assets/cassie.xml` by default.
        period: time between packets [s]; the filter assumes the same robot at any.
        noise: what the filter assumes.

    Raises:
        ConfigurationError: `period` is not between 0 and 1 s.
    """

    def __init__(
        self,
        model: mujoco.MjModel | None = None,
        *,
        period: float = CASSIE.packet_period,
        noise: FilterNoise | None = None,
    ) -> None:
        if not 0 < period < 1:
            raise ConfigurationError(f"period must be the seconds between packets, got {period!r}")
        robot: Any = load_model(visual=False) if model is None else model
        self.period = period
        self._screen = Screen(period)
        self._doubt = _DOUBT * (CASSIE.packet_period / period) ** 0.5
        self._legs = LegKinematics(robot)
        self._filter = ContactFilter(
            period, self._legs.sole_radius, self._legs.half_length, noise or FilterNoise()
        )
        self._imu = robot.site("imu").pos.copy()
        # alpha x r = alpha @ arm
        self._arm = np.cross(np.eye(3), self._imu)
        self._standing = _standing(robot)

    def start(
        self,
        packets: Mapping[str, np.ndarray] | np.ndarray,
        heading: ArrayLike | None = None,
    ) -> tuple[Tracking, Estimate]:
        """Begin with robots whose lower foot rests on the ground.

        The velocity is that which keeps the foot at rest, the height that which puts it there.
        Readings that are missing are those of a standing robot until better ones come.

        Args:
            packets: the last packet of each window is taken.
            heading: yaw that is straight ahead, in the frame of the IMU's attitude [rad]: one, or
                (n,) or (n, 1). By default that of the first packet, zero if its orientation is
                missing.

        Raises:
            ShapeError, UnknownNameError: the packets lack an entry or have the wrong shape, or
                there are not as many headings as robots.
            ConfigurationError: a heading is not finite.
        """
        rows = _windows(packets)[:, -1:]
        num = len(rows)
        blind = PacketMemory.of(np.tile(self._standing, (num, 1)))
        # what was before is not known: nothing is a jump, and nothing repeats itself
        blind.jumps += np.inf
        blind.repeats -= np.inf
        screened = self._screen(rows, blind)
        memory = PacketMemory.of(blind.reading)
        motions, geometry = self._interpret(memory.reading, np.zeros((num, 3)), _good(screened))
        belief = self._filter.start(motions[0], self._sole_velocity(memory.reading))
        ahead = (
            yaw(memory.reading[:, SLICES["orientation"]])
            if heading is None
            else _headings(heading, num)
        )
        tracking = Tracking(belief, memory, geometry.angular_acceleration, ahead)
        nothing, resting = np.full((num, 1, 2, 3), np.nan), np.zeros((num, 1, 2), dtype=bool)
        return tracking, self._describe(tracking, geometry, screened.faults, nothing, resting)

    def update(
        self, tracking: Tracking, packets: Mapping[str, np.ndarray] | np.ndarray | None
    ) -> Estimate:
        """Take packets into account; `tracking` changes in place.

        Args:
            tracking: from `start`.
            packets: one packet of one robot, or (n, w) of them.

        Raises:
            ShapeError, UnknownNameError: the packets lack an entry, have the wrong shape, or are
                of another number of robots.
        """
        num = len(tracking.packets.reading)
        rows = np.full((num, 1, PACKET_SIZE), np.nan) if packets is None else _windows(packets)
        if len(rows) != num:
            raise ShapeError(f"packets must be those of {num} robots, got {len(rows)}")
        before = tracking.packets.reading
        screened = self._screen(rows, tracking.packets)
        motions, geometry = self._interpret(before, tracking.angular_acceleration, screened)
        tracking.angular_acceleration = geometry.angular_acceleration
        innovation = np.empty((num, len(motions), 2, 3))
        resting = np.empty((num, len(motions), 2), dtype=bool)
        for k, motion in enumerate(motions):
            self._filter.step(tracking.belief, motion)
            innovation[:, k] = tracking.belief.innovation
            resting[:, k] = tracking.belief.resting
        return self._describe(tracking, geometry, screened.faults, innovation, resting)

    def _interpret(
        self, before: np.ndarray, angular_before: np.ndarray, screened: Screened
    ) -> tuple[list[Motion], _Geometry]:
        """What readings say about motion: packet by packet, and in detail for the last."""
        readings, age = screened.readings, screened.age
        num, window, _ = readings.shape
        both = np.concatenate([before[:, None], readings], axis=1)
        orientation = both[..., SLICES["orientation"]].reshape(-1, 4)
        turn = Rotation.from_quat(orientation, scalar_first=True).as_matrix()
        turn = turn.reshape(num, window + 1, 3, 3)
        gyro = both[..., SLICES["gyro"]]
        angular = self._angular_acceleration(gyro, angular_before, age[..., :3])
        # the accelerometer gives means over the time since the packet before, also after a gap
        middle = (gyro[:, 1:] + gyro[:, :-1]) / 2
        middle = np.where(age[..., :3] > 1, gyro[:, 1:] - angular * (self.period / 2), middle)
        # of the pelvis' origin: a - alpha x r - omega x (omega x r)
        proper = readings[..., SLICES["accelerometer"]] - angular @ self._arm
        proper -= (middle @ self._imu)[..., None] * middle
        proper += (middle**2).sum(-1, keepdims=True) * self._imu
        mean_turn = (turn[:, 1:] + turn[:, :-1]) / 2
        mean_turn = np.where(age[..., 3:, None] > 1, turn[:, 1:], mean_turn)
        acceleration = (mean_turn @ proper[..., None])[..., 0]
        acceleration[..., 2] -= STANDARD_GRAVITY

        vectors = self._legs(
            readings[..., SLICES["motor_position"]], readings[..., SLICES["joint_position"]]
        )
        vectors = vectors @ turn[:, 1:, None].swapaxes(-1, -2)
        sole = (vectors[..., HEEL, :] + vectors[..., TOE, :]) / 2
        half = vectors[..., TOE, :] - sole
        doubt = np.where(screened.imu, 0.0, self._doubt)
        # packet by packet: contiguous arrays are what the filter is compiled for
        columns = (acceleration, doubt, sole, half, vectors[..., FORCE, 2], screened.legs)
        packets = zip(*(np.ascontiguousarray(x.swapaxes(0, 1)) for x in columns), strict=True)
        motions = [Motion(*packet) for packet in packets]
        gravity = STANDARD_GRAVITY * turn[:, -1, 2]
        lateral = vectors[:, -1, :, LATERAL]
        own = proper[:, -1] - gravity
        return motions, _Geometry(sole[:, -1], half[:, -1], lateral, own, angular[:, -1].copy())

    def _angular_acceleration(
        self, gyro: np.ndarray, before: np.ndarray, age: np.ndarray
    ) -> np.ndarray:
        """(n, w, 3) between the last two readings of the gyro at each packet [rad/s^2].

        Args:
            gyro: (n, w + 1, 3) readings, from the packet before the window on.
            before: (n, 3) result at the packet before the window.
            age: (n, w, 3) packets between a new reading and the one before; zero where none is new.
        """
        angular = (gyro[:, 1:] - gyro[:, :-1]) / (self.period * np.maximum(age, 1))
        for k in np.flatnonzero((age == 0).any((0, 2))):
            held = angular[:, k - 1] if k else before
            angular[:, k] = np.where(age[:, k] == 0, held, angular[:, k])
        return angular

    def _sole_velocity(self, reading: np.ndarray) -> np.ndarray:
        """(n, 2, 3) velocities of the soles relative to the pelvis [m/s, world]."""
        motors, joints = (
            (
                reading[:, SLICES[f"{kind}_position"]],
                reading[:, SLICES[f"{kind}_velocity"]] * _DIFFERENCE,
            )
            for kind in ("motor", "joint")
        )
        feet = [
            self._legs(motors[0] + sign * motors[1], joints[0] + sign * joints[1])
            for sign in (-1, 1)
        ]
        soles = [foot[:, :, [HEEL, TOE]].mean(2) for foot in feet]
        velocity = (soles[1] - soles[0]) / (2 * _DIFFERENCE)
        gyro = reading[:, None, SLICES["gyro"]]
        velocity += np.cross(gyro, (soles[0] + soles[1]) / 2)
        turn = Rotation.from_quat(reading[:, SLICES["orientation"]], scalar_first=True).as_matrix()
        return velocity @ turn.swapaxes(-1, -2)

    def _describe(
        self,
        tracking: Tracking,
        geometry: _Geometry,
        faults: np.ndarray,
        innovation: np.ndarray,
        resting: np.ndarray,
    ) -> Estimate:
        mean, reading, heading = tracking.belief.mean, tracking.packets.reading, tracking.heading
        position = vector_to_heading(heading, mean[..., P])
        return Estimate(
            height=position[:, 2:],
            orientation=normalize(
                orientation_to_heading(heading, reading[:, SLICES["orientation"]])
            ),
            velocity=vector_to_heading(heading, mean[..., V]),
            angular_velocity=reading[:, SLICES["gyro"]],
            acceleration=geometry.acceleration,
            motor_position=reading[:, SLICES["motor_position"]],
            motor_velocity=reading[:, SLICES["motor_velocity"]],
            joint_position=reading[:, SLICES["joint_position"]],
            joint_velocity=reading[:, SLICES["joint_velocity"]],
            position=position,
            sole=vector_to_heading(heading, geometry.sole),
            forward=vector_to_heading(heading, geometry.half_sole) / self._legs.half_length,
            left=vector_to_heading(heading, geometry.lateral),
            sole_radius=self._legs.sole_radius,
            contact=tracking.belief.loaded.copy(),
            innovation=innovation,
            resting=resting,
            faults=faults.max(1),
        )


@dataclass(frozen=True)
class _Geometry:
    """Feet and acceleration at the last packet."""

    sole: np.ndarray
    half_sole: np.ndarray
    lateral: np.ndarray
    acceleration: np.ndarray
    angular_acceleration: np.ndarray


def _headings(heading: ArrayLike, num: int) -> np.ndarray:
    """(num,) headings from one, (num,) or (num, 1)."""
    values = np.asarray(heading, dtype=np.float64)
    if values.shape not in ((), (num,), (num, 1)):
        raise ShapeError(f"heading must be one number or ({num}, 1), got the shape {values.shape}")
    if not np.isfinite(values).all():
        raise ConfigurationError(f"heading must be finite, got {values.tolist()}")
    return np.broadcast_to(values.reshape(-1), (num,)).copy()


def _good(screened: Screened) -> Screened:
    """Copy of the screened packets with all readings marked good."""
    legs, imu, age = (np.ones_like(field) for field in (screened.legs, screened.imu, screened.age))
    return screened._replace(legs=legs, imu=imu, age=age)


def _windows(packets: Mapping[str, np.ndarray] | np.ndarray) -> np.ndarray:
    """(n, w, 42) from any way to write packets."""
    rows = join(packets) if isinstance(packets, Mapping) else np.asarray(packets, dtype=np.float64)
    if rows.ndim not in (1, 3) or rows.shape[-1] != PACKET_SIZE:
        raise ShapeError(
            f"packets must have the shape ({PACKET_SIZE},) or (n, w, {PACKET_SIZE}),"
            f" got {rows.shape}"
        )
    if rows.ndim == 1:
        return rows[None, None]
    return rows


def _standing(model: mujoco.MjModel) -> np.ndarray:
    """(42,) readings of a robot that stands upright."""
    indices, qpos = CASSIE.indices, model.key("standing").qpos
    reading = np.zeros(PACKET_SIZE)
    reading[SLICES["motor_position"]] = qpos[indices.motor_qpos]
    reading[SLICES["joint_position"]] = qpos[indices.joint_qpos]
    reading[SLICES["orientation"]] = [1.0, 0.0, 0.0, 0.0]
    reading[SLICES["accelerometer"]] = [0.0, 0.0, STANDARD_GRAVITY]
    return reading
