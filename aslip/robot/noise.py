"""Noise of a robot's sensors."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from aslip.errors import ConfigurationError, ShapeError


def _frozen(name: str, value: ArrayLike) -> float | tuple[float, ...]:
    """Standard deviations as a float or a tuple of floats."""
    try:
        array = np.asarray(value)
        numeric = array.dtype.kind in "fiu"
    except ValueError:  # ragged
        array, numeric = np.empty(0), False
    if not numeric or not np.all(np.isfinite(array) & (array >= 0)):
        raise ConfigurationError(f"{name} must be finite and 0 or more, got {value!r}")
    if array.ndim > 1:
        raise ShapeError(f"{name} must be one number or one per channel, got shape {array.shape}")
    return float(array) if array.ndim == 0 else tuple(array.astype(float).tolist())


@dataclass(frozen=True)
class NoiseLevel:
    """Standard deviations of a sensor's errors, one for all channels or one per channel.

    Units are those of the sensor. The error of an orientation is a rotation vector in the pelvis
    frame [rad].

    Raises:
        ConfigurationError: a value is negative or not a finite number.
        ShapeError: the values have more than one axis.
    """

    white: ArrayLike = 0.0
    """White noise, drawn for every packet."""
    bias: ArrayLike = 0.0
    """Slowly varying bias of an episode."""

    def __post_init__(self) -> None:
        for field in fields(self):
            # unlike arrays, tuples are immutable and comparable
            object.__setattr__(self, field.name, _frozen(field.name, getattr(self, field.name)))
