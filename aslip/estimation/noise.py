"""Noise that the Kalman filter of the estimator assumes."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from aslip.base.checks import TINY, check_number
from aslip.errors import ConfigurationError

_POSITIVE = ("leg", "ground", "gate", "rock")


@dataclass(frozen=True)
class FilterNoise:
    """Standard deviations and thresholds of the filter, tuned on walks of the shipped policy.

    The values hold for packets every 3 ms.

    Raises:
        ConfigurationError: a value is negative or not a finite number, is zero although the filter
            divides by it, or `unload` exceeds `load`.
    """

    acceleration: float = 0.2
    """Mean acceleration over 3 ms [m/s^2], white."""
    shock: float = 0.05
    """Further error in proportion to that acceleration, for impacts between samples."""
    acceleration_error: float = 0.02
    """Random walk of the acceleration error [m/s^2 / sqrt(s)]: tilt and bias."""
    slip: float = 0.012
    """Random walk of a sole at rest, along the ground [m / sqrt(s)]."""
    sink: float = 0.004
    """Random walk of a sole at rest, across the ground [m / sqrt(s)]."""
    leg: float = 1.2e-4
    """Position of a sole from encoders [m], white, every 3 ms."""
    ground: float = 2e-3
    """Height of the lowest point of a sole at rest [m], white, every 3 ms: compliance and uneven
    ground. Infinite for ground of any height, as on stones and stairs: then positions drift across
    the ground as they do along it, and `Estimate.height` counts from the loaded feet."""
    gate: float = 16.0
    """Largest normalised innovation squared of a foot at rest, on any axis."""
    load: float = 60.0
    """Force on a foot from which it is in contact [N]."""
    unload: float = 45.0
    """Force on a foot below which contact ends [N]."""
    rock: float = 0.05
    """Pitch of a sole from which it stands on heel or toes only [rad]."""
    initial_height: float = 0.02
    """Height at the start [m]."""
    initial_velocity: float = 0.2
    """Velocity at the start [m/s]."""
    initial_acceleration_error: float = 0.1
    """Acceleration error at the start [m/s^2]."""
    patience: float = 0.09
    """Time with a loaded foot but no foot at rest [s] after which the filter adds `surprise` and
    `surprise_height`."""
    surprise: float = 0.5
    """Standard deviation added to the velocity after that time [m/s]."""
    surprise_height: float = 0.1
    """Standard deviation added to the height after that time [m]."""

    def __post_init__(self) -> None:
        """Check the values."""
        for field in fields(self):
            least, value = TINY if field.name in _POSITIVE else 0.0, getattr(self, field.name)
            if field.name != "ground" or value != math.inf:
                check_number(f"{field.name} of FilterNoise", value, least)
        if self.unload > self.load:
            raise ConfigurationError(
                f"unload of FilterNoise must be at most load, got {self.unload!r} N and"
                f" {self.load!r} N"
            )
