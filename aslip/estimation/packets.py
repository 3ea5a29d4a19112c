"""Sensor packets as rows of numbers, and screening of bad readings.

Readings of a robot can be bad: a packet is lost (all NaN), a device freezes, a bit flips. Each
reading is compared with the range of its device, and readings of the IMU also with their largest
change. A bad reading is reported, and replaced by the last good one of the same channel.

An IMU may be slower than the packets and repeat readings; that is no fault as long as a new one
comes every 5 ms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from aslip.base.arrays import Array, copied, is_numpy, namespace
from aslip.errors import ShapeError, UnknownNameError
from aslip.robot import CASSIE, Robot
from aslip.robot.robot import LARGEST, UNIT_TOLERANCE

FAULTS: Final = ("missing", "implausible", "jump", "frozen")
"""Faults of a packet: a reading is NaN or infinite; a reading is out of the device's range; the IMU
changed faster than a robot can; the IMU has repeated all bits for longer than 5 ms."""

MISSING, IMPLAUSIBLE, JUMP, FROZEN = range(len(FAULTS))

_ENCODERS = ("motor_position", "motor_velocity", "joint_position", "joint_velocity")
# largest change of gyro and accelerometer in 3 ms; walking stays below 0.7 rad/s and 20 m/s^2
_LARGEST_JUMP = np.array([3.0] * 3 + [60.0] * 3)
# time [s] after which a lasting jump is accepted
_PERSISTENT = 0.009
# longest time [s] between readings of an IMU that is not frozen, 200 Hz
_SLOWEST_IMU = 0.005


def join(packet: Mapping[str, np.ndarray], robot: Robot = CASSIE) -> np.ndarray:
    """Join the entries of packets, each (*b, k), to one array (*b, p).

    Args:
        packet: entries of `Robot.packet_sizes`.
        robot: robot that sends the packets.

    Raises:
        UnknownNameError: an entry is missing.
        ShapeError: an entry has another size.
    """
    entries = []
    for name, size in robot.packet_sizes.items():
        if name not in packet:
            raise UnknownNameError(
                f"a packet needs {list(robot.packet_sizes)}; {name!r} is missing"
                " (send NaN for lost readings)"
            )
        entry = np.asarray(packet[name], dtype=np.float64)
        if entry.shape[-1:] != (size,):
            raise ShapeError(f"{name} of a packet must have {size} numbers, got {entry.shape}")
        entries.append(entry)
    return np.concatenate(entries, axis=-1)


@dataclass
class PacketMemory:
    """Memory of n robots' packets."""

    reading: Array
    """(n, p) last good readings."""
    jumps: Array
    """(n,) successive packets with a jump of the IMU."""
    repeats: Array
    """(n,) successive packets in which the IMU repeated itself."""
    age: Array
    """(n, 4) packets since the last new reading of each gyro axis and the attitude."""

    @classmethod
    def of(cls, reading: Array) -> PacketMemory:
        """Memory of robots whose readings (n, p) are new and good."""
        xp = namespace(reading)
        jumps, repeats = (xp.zeros_like(reading[:, 0]) for _ in range(2))
        return cls(reading, jumps, repeats, xp.zeros_like(reading[:, :4]))


class Screened(NamedTuple):
    """Windows of packets of n robots, with bad readings replaced."""

    readings: Array
    """(n, w, p) readings; the packets themselves if all are good."""
    faults: Array
    """(n, w, 4) bool, `FAULTS` of each packet."""
    legs: Array
    """(n, w, 2) bool, all readings of a leg are good."""
    imu: Array
    """(n, w) bool, all readings of the IMU are good."""
    age: Array
    """(n, w, 4) packets between a new reading and the previous one, for each gyro axis and the
    attitude; zero without a new reading."""


class Screen:
    """Screen that replaces bad readings in windows of packets by the last good ones.

    Args:
        robot: robot that sends the packets.
        place: what makes constants arrays of the packets' kind.
    """

    def __init__(self, robot: Robot, place: Callable[[np.ndarray], Array] = np.asarray) -> None:
        at, sizes = robot.packet_slices, robot.packet_sizes
        limit = np.concatenate([np.full(n, LARGEST[name]) for name, n in sizes.items()])
        self._limit, self._largest_jump = place(limit), place(_LARGEST_JUMP)
        self._orientation, self._gyro = at["orientation"], at["gyro"]
        self._imu = slice(self._gyro.start, robot.packet_size)
        # channels of each leg: half of each encoder entry
        numbers = np.arange(robot.packet_size)
        encoders = [np.split(numbers[at[name]], 2) for name in _ENCODERS]
        self._legs = [place(np.concatenate([entry[leg] for entry in encoders])) for leg in (0, 1)]
        self._persistent = round(_PERSISTENT / robot.packet_period)
        self._most_repeats = int(_SLOWEST_IMU / robot.packet_period)

    # readings near the largest number of double precision overflow
    @np.errstate(over="ignore", invalid="ignore")
    def __call__(self, packets: Array, memory: PacketMemory) -> Screened:
        """Screen (n, w, p) packets, oldest first; `memory` changes in place."""
        xp = namespace(packets)
        good = abs(packets) <= self._limit
        length = (packets[..., self._orientation] ** 2).sum(-1)
        good[..., self._orientation] &= (abs(length - 1) <= UNIT_TOLERANCE)[..., None]
        imu = xp.concatenate([memory.reading[:, None, self._imu], packets[..., self._imu]], axis=1)
        change = abs(imu[:, 1:] - imu[:, :-1])
        # != counts a change to NaN as movement
        moving = xp.amax(change, -1) != 0
        if not is_numpy(packets):  # asking whether all is good would wait for the device
            return self._mend(packets, memory, good, moving)
        smooth = (change <= self._largest_jump).all(-1)
        if not (good.all() and smooth.all() and moving.all()) or memory.age.any():
            return self._mend(packets, memory, good, moving)
        num, window, _ = packets.shape
        memory.jumps[:] = memory.repeats[:] = 0
        # copy, as the caller may reuse the buffer of packets
        memory.reading = copied(packets[:, -1])
        faults = np.zeros((num, window, len(FAULTS)), dtype=bool)
        legs = np.ones((num, window, 2), dtype=bool)
        return Screened(packets, faults, legs, legs[..., 0], np.ones((num, window, 4)))

    def _mend(self, packets: Array, memory: PacketMemory, good: Array, moving: Array) -> Screened:
        xp = namespace(packets)
        number = xp.isfinite(packets)
        faults = xp.zeros_like(good[..., : len(FAULTS)])
        faults[..., MISSING] = ~number.all(-1)
        faults[..., IMPLAUSIBLE] = (number & ~good).any(-1)
        readings, age = [], []
        for k in range(packets.shape[1]):
            packet, valid = packets[:, k], good[:, k]
            memory.repeats = xp.where(moving[:, k], 0, memory.repeats + 1)
            frozen = memory.repeats > self._most_repeats
            valid[:, self._imu] &= ~frozen[:, None]
            # if the whole packet repeats, the readings of the legs are old, too
            valid &= ~(frozen & (packet == memory.reading).all(-1))[:, None]
            jump = self._jumps(packet, memory, valid)
            valid[:, self._imu] &= ~jump[:, None]
            faults[:, k, FROZEN], faults[:, k, JUMP] = frozen, jump
            memory.reading = xp.where(valid, packet, memory.reading)
            readings.append(memory.reading)
            attitude = valid[:, self._orientation].all(-1)[:, None]
            new = xp.concatenate([valid[:, self._gyro], attitude], axis=1) & moving[:, k, None]
            age.append(xp.where(new, memory.age + 1, 0))
            memory.age = xp.where(new, 0, memory.age + 1)
        legs = xp.stack([xp.amin(good[..., channels], -1) for channels in self._legs], axis=-1)
        imu = xp.amin(good[..., self._orientation.start :], -1)
        return Screened(xp.stack(readings, axis=1), faults, legs, imu, xp.stack(age, axis=1))

    def _jumps(self, packet: Array, memory: PacketMemory, valid: Array) -> Array:
        """(n,) bool, True where the IMU jumps in packets (n, p); counts successive jumps."""
        change = abs(packet[:, self._imu] - memory.reading[:, self._imu])
        fast = (change > self._largest_jump).any(-1) & valid[:, self._imu].all(-1)
        jump = fast & (memory.jumps < self._persistent)
        memory.jumps[:] = namespace(packet).where(jump, memory.jumps + 1, 0)
        return jump


def read_windows(packets: Mapping[str, np.ndarray] | Array, robot: Robot = CASSIE) -> Array:
    """Convert one packet of one robot, or (n, w) packets, to an array (n, w, p).

    Raises:
        ShapeError, UnknownNameError: the packets lack an entry or have the wrong shape.
    """
    if isinstance(packets, Mapping):
        rows = join(packets, robot)
    else:
        tensor = hasattr(packets, "device") and not is_numpy(packets)
        rows = packets.double() if tensor else np.asarray(packets, dtype=np.float64)
    size = robot.packet_size
    if rows.ndim not in (1, 3) or rows.shape[-1] != size:
        raise ShapeError(
            f"packets must have the shape ({size},) or (n, w, {size}), got {rows.shape}"
        )
    return rows[None, None] if rows.ndim == 1 else rows
