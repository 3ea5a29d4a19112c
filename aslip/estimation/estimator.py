"""State estimator of a batch of robots, or of one robot that streams its packets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aslip.base.arrays import Array, contiguous, copied, is_numpy, namespace
from aslip.errors import ConfigurationError, ShapeError
from aslip.estimation.filter import LEFT, Belief, ContactFilter, FilterInput, P, V
from aslip.estimation.legs import FORCE, HEEL, LATERAL, TOE, LegKinematics
from aslip.estimation.noise import FilterNoise
from aslip.estimation.packets import PacketMemory, Screen, Screened, read_windows
from aslip.estimation.state import Estimate, Tracking
from aslip.robot import CASSIE, STANDARD_GRAVITY, Robot
from aslip.robot.rotation import (
    cross,
    normalize,
    orientation_to_heading,
    quaternion_to_matrix,
    vector_to_heading,
    yaw,
)

# standard deviation [m/s^2] of the mean over 3 ms of an acceleration without a good reading
_DOUBT = 5.0
# load [N] of a foot that stands for all feet if none is loaded
_LEAST_LOAD = 1e-3
# step [s] of finite differences of the legs' kinematics
_DIFFERENCE = 1e-5


class StateEstimator:
    """Estimator of the pelvis, legs and feet of n robots from sensor packets.

    The estimator itself has no state: `Tracking` is its memory of the robots. On a robot:

        estimator = StateEstimator()
        tracking, estimate = estimator.start(packet)
        while True:
            estimate = estimator.update(tracking, packet)

    A packet is a mapping with the entries of `Robot.packet_sizes`, or an array of their p numbers.
    Windows of w packets of n robots, oldest first, have the leading shape (n, w). The accelerometer
    gives the mean since the previous packet.

    NaN, values out of range, spikes of the IMU and a frozen IMU are faults (`Estimate.faults`). The
    last good readings replace bad ones, the variance of the acceleration increases, and a leg with
    a bad reading gives no measurement. An IMU slower than the packets, down to 200 Hz, is no fault.
    `None` stands for a lost packet. Robots do not affect each other.

    Args:
        robot: robot that sends the packets; `LegKinematics` must support its legs.
        noise: noise that the filter assumes.
        place: what makes constants arrays of the packets' kind; NumPy's by default.
    """

    takes_tensors = False
    """True if packets, memory and estimates are tensors of torch."""

    def __init__(
        self,
        robot: Robot = CASSIE,
        noise: FilterNoise | None = None,
        place: Callable[[np.ndarray], Array] = np.asarray,
    ) -> None:
        self.robot = robot
        """Robot that sends the packets."""
        self.noise = noise or FilterNoise()
        """Noise that the filter assumes."""
        self._at = robot.packet_slices
        self._screen = Screen(robot, place)
        self._legs = LegKinematics(robot, place)
        self._filter = ContactFilter(
            robot.packet_period,
            self._legs.sole_radius,
            self._legs.half_length,
            self.noise,
        )
        imu = np.array(robot.skeleton.sites[robot.imu_site].position)
        # alpha x imu = alpha @ arm
        self._imu, self._arm = place(imu), place(np.cross(np.eye(3), imu))
        self._standing = place(_standing(robot))

    def start(
        self,
        packets: Mapping[str, np.ndarray] | Array,
        heading: ArrayLike | None = None,
    ) -> tuple[Tracking, Estimate]:
        """Start to track robots, assuming that the lower foot rests on the ground.

        This determines height and velocity of the pelvis. Until their first good readings, missing
        channels have the values of a standing robot.

        Args:
            packets: packets; of a window only the last one counts.
            heading: yaw of the straight-ahead direction in the frame of the IMU's attitude [rad]:
                one number, (n,) or (n, 1). By default the yaw of the first packet, or zero without
                an orientation.

        Raises:
            ShapeError, UnknownNameError: the packets lack an entry or have the wrong shape, or the
                number of headings is wrong.
            ConfigurationError: a heading is not finite.
        """
        rows = read_windows(packets, self.robot)[:, -1:]
        xp, num = namespace(rows), len(rows)
        blind = PacketMemory.of(xp.zeros_like(rows[:, 0]) + self._standing)
        # without earlier packets, no reading is a jump or a repetition
        blind.jumps += np.inf
        blind.repeats -= np.inf
        screened = self._screen(rows, blind)
        memory = PacketMemory.of(blind.reading)
        good = {name: xp.ones_like(getattr(screened, name)) for name in ("legs", "imu", "age")}
        motions, geometry = self._interpret(
            memory.reading, xp.zeros_like(rows[:, 0, :3]), screened._replace(**good)
        )
        belief = self._filter.start(motions[0], self._sole_velocity(memory.reading))
        if heading is None:
            heading = yaw(memory.reading[:, self._at["orientation"]])
        headings = xp.asarray(heading, dtype=rows.dtype).reshape(-1)
        headings = copied(xp.broadcast_to(headings, (num,)))
        if not xp.isfinite(headings).all():
            raise ConfigurationError(f"heading must be finite, got {headings.tolist()}")
        tracking = Tracking(belief, memory, geometry.angular_acceleration, headings)
        nothing, resting = (copied(x)[:, None] for x in (belief.innovation, belief.resting))
        return tracking, self._describe(tracking, geometry, screened.faults, nothing, resting)

    def update(
        self, tracking: Tracking, packets: Mapping[str, np.ndarray] | Array | None
    ) -> Estimate:
        """Update `tracking` in place with packets, and estimate the state.

        Args:
            tracking: memory from `start`.
            packets: one packet of one robot, or (n, w) packets.

        Raises:
            ShapeError, UnknownNameError: the packets lack an entry, have the wrong shape or another
                number of robots.
        """
        num = len(tracking.packets.reading)
        rows = (
            np.full((num, 1, self.robot.packet_size), np.nan)
            if packets is None
            else read_windows(packets, self.robot)
        )
        if len(rows) != num:
            raise ShapeError(f"packets must come from {num} robots, got {len(rows)}")
        before = tracking.packets.reading
        screened = self._screen(rows, tracking.packets)
        motions, geometry = self._interpret(before, tracking.angular_acceleration, screened)
        tracking.angular_acceleration = geometry.angular_acceleration
        innovation, resting = [], []
        for motion in motions:
            self._filter.step(tracking.belief, motion)
            innovation.append(copied(tracking.belief.innovation))
            resting.append(copied(tracking.belief.resting))
        innovation, resting = (namespace(rows).stack(x, axis=1) for x in (innovation, resting))
        return self._describe(tracking, geometry, screened.faults, innovation, resting)

    def _interpret(
        self, before: Array, angular_before: Array, screened: Screened
    ) -> tuple[list[FilterInput], _Geometry]:
        """Motion at each packet for the filter, and more geometry at the last one."""
        readings, age = screened.readings, screened.age
        xp = namespace(readings)
        both = xp.concatenate([before[:, None], readings], axis=1)
        turn = quaternion_to_matrix(both[..., self._at["orientation"]])
        gyro = both[..., self._at["gyro"]]
        angular = self._angular_acceleration(gyro, angular_before, age[..., :3])
        # an accelerometer's mean covers the time since the previous packet, also after a gap
        middle = (gyro[:, 1:] + gyro[:, :-1]) / 2
        middle = xp.where(
            age[..., :3] > 1, gyro[:, 1:] - angular * (self.robot.packet_period / 2), middle
        )
        # at the pelvis' origin: a - alpha x r - omega x (omega x r)
        proper = readings[..., self._at["accelerometer"]] - angular @ self._arm
        proper -= (middle @ self._imu)[..., None] * middle
        proper += (middle**2).sum(-1, keepdims=True) * self._imu
        mean_turn = (turn[:, 1:] + turn[:, :-1]) / 2
        mean_turn = xp.where(age[..., 3:, None] > 1, turn[:, 1:], mean_turn)
        acceleration = (mean_turn @ proper[..., None])[..., 0]
        acceleration[..., 2] -= STANDARD_GRAVITY

        vectors = self._legs(
            readings[..., self._at["motor_position"]], readings[..., self._at["joint_position"]]
        )
        vectors = vectors @ turn[:, 1:, None].swapaxes(-1, -2)
        sole = (vectors[..., HEEL, :] + vectors[..., TOE, :]) / 2
        half = vectors[..., TOE, :] - sole
        doubt, load = xp.where(screened.imu, 0.0, _DOUBT), vectors[..., FORCE, 2]
        # the filter is compiled for contiguous arrays of one packet
        columns = (acceleration, doubt, sole, half, load, screened.legs)
        packets = zip(*(contiguous(x.swapaxes(0, 1)) for x in columns), strict=True)
        motions = [FilterInput(*packet) for packet in packets]
        gravity = STANDARD_GRAVITY * turn[:, -1, 2]
        lateral = vectors[:, -1, :, LATERAL]
        own = proper[:, -1] - gravity
        last = (sole[:, -1], half[:, -1], lateral, load[:, -1], own, copied(angular[:, -1]))
        return motions, _Geometry(*last)

    def _angular_acceleration(self, gyro: Array, before: Array, age: Array) -> Array:
        """Angular acceleration (n, w, 3) between the last two readings at each packet [rad/s^2].

        Args:
            gyro: (n, w + 1, 3) readings, from the packet before the window on.
            before: (n, 3) angular acceleration at the packet before the window.
            age: (n, w, 3) packets between a new reading and the previous one; zero without a new
                reading.
        """
        xp = namespace(age)
        held = age == 0
        packets = np.flatnonzero(held.any((0, 2))) if is_numpy(age) else range(age.shape[1])
        angular = (gyro[:, 1:] - gyro[:, :-1]) / (self.robot.packet_period * xp.clip(age, 1, None))
        for k in packets:
            last = angular[:, k - 1] if k else before
            angular[:, k] = xp.where(held[:, k], last, angular[:, k])
        return angular

    def _sole_velocity(self, reading: Array) -> Array:
        """(n, 2, 3) velocities of the soles relative to the pelvis [m/s, world]."""
        motors, joints = (
            (
                reading[:, self._at[f"{kind}_position"]],
                reading[:, self._at[f"{kind}_velocity"]] * _DIFFERENCE,
            )
            for kind in ("motor", "joint")
        )
        feet = [
            self._legs(motors[0] + sign * motors[1], joints[0] + sign * joints[1])
            for sign in (-1, 1)
        ]
        soles = [foot[:, :, HEEL : TOE + 1].mean(2) for foot in feet]
        velocity = (soles[1] - soles[0]) / (2 * _DIFFERENCE)
        gyro = reading[:, None, self._at["gyro"]]
        velocity += cross(gyro, (soles[0] + soles[1]) / 2)
        turn = quaternion_to_matrix(reading[:, self._at["orientation"]])
        return velocity @ turn.swapaxes(-1, -2)

    def _describe(
        self,
        tracking: Tracking,
        geometry: _Geometry,
        faults: Array,
        innovation: Array,
        resting: Array,
    ) -> Estimate:
        mean, reading, heading = tracking.belief.mean, tracking.packets.reading, tracking.heading
        # one call for all vectors: NumPy's overhead exceeds the arithmetic of few robots
        vectors = namespace(mean).concatenate(
            [
                mean[..., None, :, P],
                mean[..., None, :, V],
                geometry.sole,
                geometry.half_sole,
                geometry.lateral,
            ],
            axis=1,
        )
        turned = vector_to_heading(heading, vectors)
        position = turned[:, 0]
        return Estimate(
            height=position[:, 2:] - self._ground(tracking.belief, geometry),
            orientation=normalize(
                orientation_to_heading(heading, reading[:, self._at["orientation"]])
            ),
            velocity=turned[:, 1],
            angular_velocity=reading[:, self._at["gyro"]],
            acceleration=geometry.acceleration,
            motor_position=reading[:, self._at["motor_position"]],
            motor_velocity=reading[:, self._at["motor_velocity"]],
            joint_position=reading[:, self._at["joint_position"]],
            joint_velocity=reading[:, self._at["joint_velocity"]],
            position=position,
            sole=turned[:, 2:4],
            forward=turned[:, 4:6] / self._legs.half_length,
            left=turned[:, 6:8],
            sole_radius=self._legs.sole_radius,
            contact=copied(tracking.belief.loaded),
            innovation=innovation,
            resting=resting,
            faults=faults.any(1),
        )

    def _ground(self, belief: Belief, geometry: _Geometry) -> Array | float:
        """(n, 1) height below the loaded feet [m]; zero on level ground."""
        if math.isfinite(self.noise.ground):
            return 0.0
        mean, load = belief.mean, geometry.load - self.noise.unload
        xp = namespace(load)
        lowest = mean[:, 2, LEFT:] - abs(geometry.half_sole[..., 2]) - self._legs.sole_radius
        # a swinging foot may seem loaded, but does not rest; if none rests, the lower foot counts
        weight = xp.where(belief.resting, xp.clip(load, 0.0, None), 0.0)
        weight = weight + _LEAST_LOAD * (lowest == xp.amin(lowest, 1)[:, None])
        return ((weight * lowest).sum(1) / weight.sum(1))[:, None]


@dataclass(frozen=True)
class _Geometry:
    """Feet and acceleration at the last packet."""

    sole: Array
    half_sole: Array
    lateral: Array
    load: Array
    acceleration: Array
    angular_acceleration: Array


def _standing(robot: Robot) -> np.ndarray:
    """(p,) readings of a robot that stands upright."""
    at, qpos, part = robot.indices, robot.standing, robot.packet_slices
    reading = np.zeros(robot.packet_size)
    reading[part["motor_position"]] = qpos[at.motor_qpos]
    reading[part["joint_position"]] = qpos[at.joint_qpos]
    reading[part["orientation"]] = [1.0, 0.0, 0.0, 0.0]
    reading[part["accelerometer"]] = [0.0, 0.0, STANDARD_GRAVITY]
    return reading
