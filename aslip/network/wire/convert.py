"""Conversions between packets of the wire and sensor packets, estimates or motor targets.

Arrays have a leading shape b: () for one packet, (n,) or (n, w) for many. The wire uses single
precision: a conversion there and back rounds once, and is exact for single-precision numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aslip.errors import ShapeError, UnknownNameError
from aslip.network.wire.packets import CASSIE_OUT, PD_IN, STATE_OUT, USER_IN
from aslip.robot import CASSIE, SIDES
from aslip.robot.rotation import rotate_inverse, upper_hemisphere

STOP_CHANNEL: Final = 8
"""Radio channel of the emergency stop; a value below zero stops the robot."""

_MOTORS = len(CASSIE.motor_names)
_IDENTITY = (1.0, 0.0, 0.0, 0.0)
# entry of an estimate -> group and field of `state_out_t`
_STATE_FIELDS = {
    "orientation": ("pelvis", "orientation"),
    "velocity": ("pelvis", "translational_velocity"),
    "angular_velocity": ("pelvis", "rotational_velocity"),
    "acceleration": ("pelvis", "translational_acceleration"),
    "motor_position": ("motor", "position"),
    "motor_velocity": ("motor", "velocity"),
    "joint_position": ("joint", "position"),
    "joint_velocity": ("joint", "velocity"),
}
_STATE_SIZES = {
    name: STATE_OUT.dtype[group][field].shape[0] for name, (group, field) in _STATE_FIELDS.items()
}
_ESTIMATE = STATE_OUT.numbers(*(".".join(path) for path in _STATE_FIELDS.values()))
ESTIMATE_ENTRIES: Final = ("height", *_STATE_FIELDS)
"""Entries of an estimate, 46 numbers in all, by the names of `("estimate", ...)`."""


class MotorCommand(NamedTuple):
    """Numbers of the PD law, each (*b, 10): motors of the left leg, then of the right leg.

    The torque at a joint is torque + stiffness (position - q) + damping (velocity - dq/dt).
    """

    torque: np.ndarray
    """Feedforward at the joints [N m]."""
    position: np.ndarray
    """Target angles [rad]."""
    velocity: np.ndarray
    """Target velocities [rad/s]."""
    stiffness: np.ndarray
    """Position gains [N m/rad]."""
    damping: np.ndarray
    """Velocity gains [N m s/rad]."""


_COMMAND_FIELDS = dict(
    zip(MotorCommand._fields, ("torque", "p_target", "d_target", "p_gain", "d_gain"), strict=True)
)
_COMMAND = PD_IN.numbers(
    *(f"{side}_leg.motor_pd.{name}" for name in _COMMAND_FIELDS.values() for side in SIDES)
)
_PARTS = CASSIE.packet_slices
# in the order of `_PARTS`
_SENSORS = CASSIE_OUT.numbers(
    *(
        f"{side}_leg.{group}.{kind}"
        for group in ("drives", "joints")
        for kind in ("position", "velocity")
        for side in SIDES
    ),
    *(
        f"pelvis.vector_nav.{name}"
        for name in ("orientation", "angular_velocity", "linear_acceleration")
    ),
)
_DRIVES = CASSIE_OUT.numbers(
    *(
        f"{side}_leg.drives.{name}"
        for name in ("torque", "torque_limit", "gear_ratio")
        for side in SIDES
    )
)


def sensors_to_cassie_out(
    sensors: Mapping[str, ArrayLike], motor_torque: ArrayLike = 0.0
) -> np.ndarray:
    """Pack sensor packets as `cassie_out_t`.

    The IMU, the radio and the encoders' calibration are marked good, the stop is released, and
    readings that a sensor packet lacks are zero.

    Args:
        sensors: entries (*b, k) of `Robot.packet_sizes`.
        motor_torque: torques at the joints (*b, 10) [N m].

    Returns:
        (*b) records of `CASSIE_OUT`.

    Raises:
        UnknownNameError: an entry is missing.
        ShapeError: an entry has the wrong shape.
    """
    entries = [_entry(sensors, name, size) for name, size in CASSIE.packet_sizes.items()]
    out = CASSIE_OUT.zeros(*entries[0].shape[:-1])
    _SENSORS.write(out, np.concatenate(entries, axis=-1))
    drives = np.empty((*out.shape, 3, _MOTORS))
    drives[..., 0, :] = motor_torque
    drives[..., 1, :] = CASSIE.torque_limit * CASSIE.gear
    drives[..., 2, :] = CASSIE.gear
    _DRIVES.write(out, drives.reshape(*out.shape, -1))
    for group, flag in ((out["pelvis"]["vector_nav"], "data_good"), (out, "is_calibrated")):
        group[flag][...] = True
    _release_stop(out["pelvis"]["radio"], "receiver_signal_good", "medulla_signal_good")
    return out


def cassie_out_to_sensors(records: np.ndarray) -> dict[str, np.ndarray]:
    """Read sensor packets out of `cassie_out_t`, in single precision.

    Args:
        records: (*b) records of `CASSIE_OUT`.

    Returns:
        Entries (*b, k) of `Robot.packet_sizes`; orientations have w >= 0. Readings that the IMU
        marks as bad are NaN.
    """
    numbers = _SENSORS.read(records)
    entries = {name: numbers[..., part] for name, part in _PARTS.items()}
    entries["orientation"][...] = upper_hemisphere(entries["orientation"])
    good = records["pelvis"]["vector_nav"]["data_good"]
    if not good.all():
        numbers[~good, _PARTS["orientation"].start :] = np.nan
    return entries


def estimate_to_state_out(
    estimate: Mapping[str, ArrayLike],
    *,
    position: ArrayLike | None = None,
    feet: ArrayLike | None = None,
    motor_torque: ArrayLike = 0.0,
) -> np.ndarray:
    """Pack estimates as `state_out_t`.

    The heading frame of the estimate becomes the world frame of the wire, with the ground at height
    zero. Feet are given as sole centres; the robot's own estimator sends a point 6 mm away. Foot
    orientations are the identity, as their frame on the wire is not documented; fields without an
    estimate are zero. The radio is marked good and the stop released.

    Args:
        estimate: entries (*b, k) of `("estimate", ...)`.
        position: position of the pelvis (*b, 3) [m, heading frame]; its z must be the estimate's
            height. By default it is above the origin.
        feet: sole centres (*b, 2, 3) [m, heading frame]; needs `position`.
        motor_torque: torques at the joints (*b, 10) [N m].

    Returns:
        (*b) records of `STATE_OUT`.

    Raises:
        UnknownNameError: an entry is missing.
        ShapeError: an entry has the wrong shape, or `feet` come without `position`.
    """
    height = _entry(estimate, "height", 1)
    out = STATE_OUT.zeros(*height.shape[:-1])
    entries = [_entry(estimate, name, size) for name, size in _STATE_SIZES.items()]
    _ESTIMATE.write(out, np.concatenate(entries, axis=-1))
    out["pelvis"]["position"][..., 2] = height[..., 0]
    out["motor"]["torque"][...] = motor_torque
    for side in SIDES:
        out[f"{side}_foot"]["orientation"][...] = _IDENTITY
    if position is not None:
        out["pelvis"]["position"][..., :2] = np.asarray(position)[..., :2]
    if feet is not None:
        if position is None:
            raise ShapeError("feet need the position of the pelvis, too")
        relative = np.asarray(feet) - np.asarray(position)[..., None, :]
        turn = _entry(estimate, "orientation", 4)[..., None, :]
        places = rotate_inverse(turn, relative)
        for i, side in enumerate(SIDES):
            out[f"{side}_foot"]["position"][...] = places[..., i, :]
    _release_stop(out["radio"], "signal_good")
    return out


def state_out_to_estimate(records: np.ndarray) -> dict[str, np.ndarray]:
    """Read estimates out of `state_out_t`, in single precision.

    Args:
        records: (*b) records of `STATE_OUT`.

    Returns:
        Entries (*b, k) of `("estimate", ...)`, with the world of the wire as heading frame;
        orientations have w >= 0.
    """
    ground = records["terrain"]["height"]
    height = (records["pelvis"]["position"][..., 2] - ground)[..., None]
    entries = {name: records[group][f].copy() for name, (group, f) in _STATE_FIELDS.items()}
    entries["orientation"] = upper_hemisphere(entries["orientation"])
    return {"height": height, **entries}


def command_to_pd_in(
    position: ArrayLike,
    stiffness: ArrayLike = CASSIE.stiffness,
    damping: ArrayLike = CASSIE.damping,
    *,
    torque: ArrayLike = 0.0,
    velocity: ArrayLike = 0.0,
) -> np.ndarray:
    """Pack motor targets and gains as `pd_in_t`; the task-space part is zero.

    Args:
        position: target angles (*b, 10) [rad].
        stiffness: position gains [N m/rad], one for all, (10,) or (*b, 10).
        damping: velocity gains [N m s/rad], as `stiffness`.
        torque: feedforward at the joints [N m], one for all, (10,) or (*b, 10).
        velocity: target velocities [rad/s], as `torque`.

    Returns:
        (*b) records of `PD_IN`.

    Raises:
        ShapeError: an argument has the wrong shape.
    """
    target = _vector("position", position, _MOTORS)
    out = PD_IN.zeros(*target.shape[:-1])
    command = MotorCommand(*map(np.asarray, (torque, target, velocity, stiffness, damping)))
    numbers = np.empty((*out.shape, len(command), _MOTORS))
    for i, (name, rows) in enumerate(zip(command._fields, command, strict=True)):
        try:
            numbers[..., i, :] = rows
        except ValueError:
            raise ShapeError(
                f"{name} must fit motor targets {target.shape}, got {rows.shape}"
            ) from None
    _COMMAND.write(out, numbers.reshape(*out.shape, -1))
    return out


def pd_in_to_command(records: np.ndarray) -> MotorCommand:
    """Read motor targets and gains (*b, 10) out of `pd_in_t`, in single precision."""
    numbers = _COMMAND.read(records)
    return MotorCommand(*(numbers[..., i : i + _MOTORS] for i in range(0, 5 * _MOTORS, _MOTORS)))


def torque_to_user_in(torque: ArrayLike) -> np.ndarray:
    """Pack torques at the joints (*b, 10) [N m] as `cassie_user_in_t`.

    Raises:
        ShapeError: there are not ten torques.
    """
    torque = _vector("torque", torque, _MOTORS)
    out = USER_IN.zeros(*torque.shape[:-1])
    out["torque"][...] = torque
    return out


def user_in_to_torque(records: np.ndarray) -> np.ndarray:
    """Read torques at the joints (*b, 10) [N m] out of `cassie_user_in_t`."""
    return records["torque"].copy()


def _release_stop(radio: np.ndarray, *flags: str) -> None:
    """Mark a radio as heard, with the emergency stop released."""
    for flag in flags:
        radio[flag][...] = True
    radio["channel"][..., STOP_CHANNEL] = 1.0


def _entry(entries: Mapping[str, ArrayLike], name: str, size: int) -> np.ndarray:
    """Entry (*b, size) of a mapping."""
    if name not in entries:
        raise UnknownNameError(f"the entry {name!r} is missing; there are {list(entries)}")
    return _vector(name, entries[name], size)


def _vector(name: str, values: ArrayLike, size: int) -> np.ndarray:
    """Array (*b, size)."""
    array = np.asarray(values)
    if array.shape[-1:] != (size,):
        raise ShapeError(f"{name} must have {size} numbers, got the shape {array.shape}")
    return array
