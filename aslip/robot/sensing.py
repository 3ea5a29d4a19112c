"""What the robot's sensors send, how often, and how wrong it is."""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot.constants import PHYSICS_TIMESTEP, SUBSTEPS
from aslip.robot.names import JOINT_NAMES, MOTOR_NAMES

PACKET_SUBSTEPS: Final = 6
"""Physics steps between packets."""

PACKET_PERIOD: Final = PACKET_SUBSTEPS * PHYSICS_TIMESTEP
"""Time between packets [s]; 333 Hz."""

SENSOR_WINDOW: Final = SUBSTEPS // PACKET_SUBSTEPS
"""Packets of a policy period, oldest first; the newest is of the last physics step's start."""

PACKET_SIZES: Final = MappingProxyType(
    {
        "motor_position": len(MOTOR_NAMES),
        "motor_velocity": len(MOTOR_NAMES),
        "joint_position": len(JOINT_NAMES),
        "joint_velocity": len(JOINT_NAMES),
        "orientation": 4,
        "gyro": 3,
        "accelerometer": 3,
    }
)
"""Entries of a packet in the order of its numbers: motors and joints [rad, rad/s], orientation
(pelvis to world, wxyz), angular velocity [rad/s] and specific force [m/s^2] of the IMU, whose axes
are the pelvis'."""

NOISE_CHANNELS: Final = MappingProxyType({**PACKET_SIZES, "orientation": 3})
"""Sensor -> number of channels that err on their own; that of the orientation is a rotation."""


def _frozen(name: str, value: ArrayLike) -> float | tuple[float, ...]:
    """A standard deviation, or several, if they are such."""
    try:
        array = np.asarray(value)
        numeric = array.dtype.kind in "fiu"
    except ValueError:  # ragged
        array, numeric = np.empty(0), False
    if not numeric or not np.all(np.isfinite(array) & (array >= 0)):
        raise ConfigurationError(f"{name} must be finite and 0 or more, got {value!r}")
    if array.ndim > 1:
        raise ShapeError(
            f"{name} must be one number or one for each channel, got the shape {array.shape}"
        )
    return float(array) if array.ndim == 0 else tuple(array.astype(float).tolist())


@dataclass(frozen=True)
class NoiseLevel:
    """Standard deviations of a sensor's errors, one for all channels or one for each.

    Units are the sensor's; an orientation errs by a rotation vector in the pelvis frame [rad].

    Raises:
        ConfigurationError: a value is negative or not finite, or is no number.
        ShapeError: the values are not in a single row.
    """

    white: ArrayLike = 0.0
    """Drawn anew for every packet; kept as a float or a tuple of floats."""
    bias: ArrayLike = 0.0
    """Drifts through an episode; kept alike."""

    def __post_init__(self) -> None:
        for field in fields(self):
            # arrays could be altered, and do not compare
            object.__setattr__(self, field.name, _frozen(field.name, getattr(self, field.name)))


SENSOR_NOISE: Final = MappingProxyType(
    {
        "motor_position": NoiseLevel(),
        "motor_velocity": NoiseLevel(),
        # shin, tarsus, foot, of both legs
        "joint_position": NoiseLevel(white=(2e-4, 2e-4, 0.0) * 2),
        "joint_velocity": NoiseLevel(white=(1.48e-2, 1.48e-2, 0.0) * 2),
        "orientation": NoiseLevel(white=5e-4, bias=1.5e-3),
        "gyro": NoiseLevel(white=5e-4, bias=1e-3),
        "accelerometer": NoiseLevel(white=1e-2, bias=2e-2),
    }
)
"""What `aslip.transforms.ObservationNoise` adds by default [rad, rad/s, m/s^2].

The model file of the robot's public simulator declares the white noise of the shin and tarsus
encoders, gyro and accelerometer; the simulator never switches it on. For the rest it declares
nothing, and we choose:

- Motor and foot encoders have no noise beyond their quantisation.
- Encoders have no bias: they are absolute, and calibrated at start-up.
- Joint velocities have what the encoders' noise becomes in the filter that makes them out of
  angles at 2 kHz (`aslip.sim.sensors.JOINT_VELOCITY_FILTER`): 74 /s times 2e-4 rad, the square root
  of the sum of the filter's squared impulse response. From packet to packet it is nearly white
  (correlation 0.08).
- Motor velocities have none, as their encoders have none.
- The orientation is the output of a filter in an inertial unit rated to 0.5 degrees (9e-3 rad); it
  errs well below the rating, and more slowly than from packet to packet.
- Gyro and accelerometer are biased by twice their white noise: over the ten packets of a policy
  step the white noise averages out to a third, so that the bias is what a filter has to deal with.
"""
