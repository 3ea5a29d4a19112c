"""Parameters of robot and floor that benchmarks sweep, and their flags."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from benchmarks.flags import WithLibrary, check_numbers


@dataclass(frozen=True)
class Sweep:
    """Display of a parameter of `aslip.sim.DYNAMICS`."""

    label: str
    """Name and unit."""
    flag: str
    """Field of `Sweeps` with its values."""
    scale: float = 1.0
    """Displayed value over the value in SI units."""
    nominal: float = 1.0
    """Displayed value of the unchanged robot."""


SWEEPS: Final = MappingProxyType(
    {
        "floor_friction": Sweep("floor friction", "floor_friction"),
        "payload": Sweep("payload [kg]", "payload", nominal=0.0),
        "slope": Sweep("slope [deg]", "slope_deg", 180 / math.pi, nominal=0.0),
        "torque_delay": Sweep("torque delay [ms]", "torque_delay_ms", 1e3, nominal=3.0),
        "motor_strength": Sweep("motor strength", "motor_strength"),
    }
)
"""Parameters that are swept, by name."""


@dataclass(frozen=True)
class Sweeps(WithLibrary):
    """Flags of sweeps of robot and floor; a parameter without values is skipped."""

    floor_friction: tuple[float, ...] = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2)
    """Coefficients of sliding friction."""
    payload: tuple[float, ...] = (0.0, 4.0, 8.0, 12.0, 16.0, 20.0)
    """Payloads at the pelvis [kg]."""
    slope_deg: tuple[float, ...] = (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0)
    """Slopes of the floor, rising forward [deg]."""
    torque_delay_ms: tuple[float, ...] = (0.0, 3.0, 5.0, 7.0, 9.0, 12.0)
    """Delays from command to torque [ms]."""
    motor_strength: tuple[float, ...] = (0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.4)
    """Ratios of delivered to commanded torque."""
    walks: int = 16
    """Walks at each value, with random commands and initial phases."""
    episode: float = 12.0
    """Duration of a walk of a sweep [s]."""

    def __post_init__(self) -> None:
        """Check number and duration of walks."""
        super().__post_init__()
        check_numbers(self, "episode", walks=1)
