"""Commanded speeds over time, and their command-line notation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aslip.errors import ConfigurationError


@dataclass(frozen=True)
class Schedule:
    """Commanded speeds over time, each held until the next."""

    times: tuple[float, ...]
    """Start time of each speed [s], ascending from 0."""
    speeds: tuple[float, ...]
    """Commanded speeds [m/s]."""

    def __post_init__(self) -> None:
        """Check the times.

        Raises:
            ConfigurationError: the times do not start at 0 or do not increase, there are not as
                many speeds, or a number is not finite.
        """
        given = f"times {self.times} and speeds {self.speeds}"
        if not self.times or len(self.times) != len(self.speeds):
            raise ConfigurationError(f"a schedule needs as many times as speeds, got {given}")
        if not all(map(math.isfinite, self.times + self.speeds)):
            raise ConfigurationError(f"a schedule needs finite numbers, got {given}")
        if self.times[0] != 0 or any(np.diff(self.times) <= 0):
            raise ConfigurationError(f"times of a schedule must increase from 0, got {given}")

    @classmethod
    def parse(cls, text: str) -> Schedule:
        """Read "time:speed,time:speed,...", or a single speed.

        Raises:
            ConfigurationError: the text has another form.
        """
        try:
            if ":" not in text:
                return cls((0.0,), (float(text),))
            pairs = [entry.split(":") for entry in text.split(",")]
            times, speeds = zip(*((float(at), float(to)) for at, to in pairs), strict=True)
        except ValueError as error:
            if isinstance(error, ConfigurationError):
                raise
            raise ConfigurationError(
                f'a schedule is "time:speed,..." such as "0:0.0,4:1.0,8:0.5", got {text!r}'
            ) from None
        return cls(times, speeds)

    def at(self, time: float) -> float:
        """Speed commanded at a time [m/s]."""
        # half a substep of tolerance: policy steps add up to 3.9999999 s
        return self.speeds[int(np.searchsorted(self.times, time + 2.5e-4, side="right")) - 1]
