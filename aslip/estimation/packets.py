"""Sensor packets as rows of numbers, and what to do about bad ones.

A robot's readings arrive incomplete now and then: a packet is lost (all NaN), a device repeats
itself, a bit flips. Each reading is checked against what the device can say at all, and those of
the IMU against how fast they can change; what fails is replaced by the last good reading, and told.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from aslip.cassie.sensing import PACKET_SIZES
from aslip.errors import ShapeError, UnknownNameError

PACKET_SIZE: Final = sum(PACKET_SIZES.values())
"""Numbers in a packet."""

_ENDS = np.cumsum([0, *PACKET_SIZES.values()])

SLICES: Final = MappingProxyType(
    {name: slice(int(_ENDS[i]), int(_ENDS[i + 1])) for i, name in enumerate(PACKET_SIZES)}
)
"""Where the entries are in a packet."""

FAULTS: Final = ("missing", "implausible", "jump", "frozen")
"""What can be wrong with a packet: a reading that is no number; one the device cannot have made;
an IMU that changed faster than a robot can; an IMU that repeats itself to the last bit."""

MISSING, IMPLAUSIBLE, JUMP, FROZEN = range(len(FAULTS))

# largest sizes: joints turn less than a turn and a half, gyro and accelerometer as the public
# simulator declares their ranges
_LARGEST = {
    "motor_position": 9.0,
    "motor_velocity": 40.0,
    "joint_position": 9.0,
    "joint_velocity": 60.0,
    "orientation": 1.01,
    "gyro": 34.9,
    "accelerometer": 157.0,
}
# unit quaternions are that long, give or take
_UNIT = 0.02
# changes from packet to packet; walking stays below 0.7 rad/s and 20 m/s^2
_LARGEST_JUMP = np.array([3.0] * 3 + [60.0] * 3)
# a jump that lasts is no spike: believe it after so many packets
_PERSISTENT = 3

_LIMIT = np.concatenate([np.full(size, _LARGEST[name]) for name, size in PACKET_SIZES.items()])
_ORIENTATION, _IMU = SLICES["orientation"], slice(SLICES["gyro"].start, PACKET_SIZE)

# channels of either leg: half of each entry before the IMU's
_ENCODERS = np.split(np.arange(_ORIENTATION.start), _ENDS[1:4])
_LEG = [np.concatenate([np.split(entry, 2)[leg] for entry in _ENCODERS]) for leg in (0, 1)]


def join(packet: Mapping[str, np.ndarray]) -> np.ndarray:
    """One array (*b, 42) of the entries of `PACKET_SIZES`, each (*b, k).

    Raises:
        UnknownNameError: an entry is missing.
        ShapeError: an entry has another size.
    """
    entries = []
    for name, size in PACKET_SIZES.items():
        if name not in packet:
            raise UnknownNameError(
                f"a packet needs {list(PACKET_SIZES)}; {name!r} is missing"
                " (send NaN for what was lost)"
            )
        entry = np.asarray(packet[name], dtype=np.float64)
        if entry.shape[-1:] != (size,):
            raise ShapeError(f"{name} of a packet must have {size} numbers, got {entry.shape}")
        entries.append(entry)
    shapes = {entry.shape[:-1] for entry in entries}
    if len(shapes) > 1:
        raise ShapeError(f"the entries of packets must have one leading shape, got {shapes}")
    return np.concatenate(entries, axis=-1)


def screen(
    packets: np.ndarray, last: np.ndarray, jumps: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find bad readings in windows of packets, and put the last good ones in their place.

    Args:
        packets: (n, w, 42), oldest first.
        last: (n, 42) last good readings before.
        jumps: (n,) jumps in a row before; advanced in place.

    Returns:
        (n, w, 42) readings, the packets themselves if nothing is wrong; (n, w, 4) bool, the
        `FAULTS`; (n, w, 2) bool, all readings of a leg are good; (n, w) bool, all of the IMU are.
    """
    num, window, _ = packets.shape
    good = np.abs(packets) <= _LIMIT
    length = (packets[..., _ORIENTATION] ** 2).sum(-1)
    good[..., _ORIENTATION] &= (np.abs(length - 1) <= _UNIT)[..., None]
    imu = np.concatenate([last[:, None, _IMU], packets[..., _IMU]], axis=1)
    change = np.abs(imu[:, 1:] - imu[:, :-1])
    smooth = (change <= _LARGEST_JUMP).all(-1)
    # not equal, rather than more: a change of NaN is no standstill
    moving = change.max(-1) != 0
    faults = np.zeros((num, window, len(FAULTS)), dtype=bool)
    if good.all() and smooth.all() and moving.all():
        jumps[:] = 0
        legs = np.ones((num, window, 2), dtype=bool)
        return packets, faults, legs, np.ones((num, window), dtype=bool)
    return _mend(packets, last, jumps, good, moving, faults)


def _mend(
    packets: np.ndarray,
    last: np.ndarray,
    jumps: np.ndarray,
    good: np.ndarray,
    moving: np.ndarray,
    faults: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    number = np.isfinite(packets)
    faults[..., MISSING] = ~number.all(-1)
    faults[..., IMPLAUSIBLE] = (number & ~good).any(-1)
    faults[..., FROZEN] = ~moving
    good = good & moving[..., None]
    readings = packets.copy()
    for k in range(packets.shape[1]):
        change = np.abs(packets[:, k, _IMU] - last[:, _IMU])
        fast = (change > _LARGEST_JUMP).any(-1) & good[:, k, _IMU].all(-1)
        jump = fast & (jumps < _PERSISTENT)
        jumps[:] = np.where(jump, jumps + 1, 0)
        faults[:, k, JUMP] = jump
        good[:, k, _IMU] &= ~jump[:, None]
        last = np.where(good[:, k], packets[:, k], last)
        readings[:, k] = last
    legs = np.stack([good[..., channels].min(-1) for channels in _LEG], axis=-1)
    return readings, faults, legs, good[..., SLICES["orientation"].start :].min(-1)
