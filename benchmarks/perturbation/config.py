"""What is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from aslip.errors import ConfigurationError
from benchmarks.flags import Common

SIDES: Final = MappingProxyType({0.0: "forward", 90.0: "left", 180.0: "back", 270.0: "right"})
"""Names of directions of pushes [deg]."""


@dataclass(frozen=True)
class Sweep:
    """How a parameter of `aslip.sim.DYNAMICS` is shown."""

    label: str
    flag: str
    """The field of `Config` that has its values."""
    shown: float = 1.0
    """Shown value over that in SI units."""
    nominal: float = 1.0
    """Shown value of the robot as it is."""


SWEEPS: Final = MappingProxyType(
    {
        "floor_friction": Sweep("floor friction", "floor_friction"),
        "payload": Sweep("payload [kg]", "payload", nominal=0.0),
        "slope": Sweep("slope [deg]", "slope_deg", 180 / math.pi, nominal=0.0),
        "torque_delay": Sweep("torque delay [ms]", "torque_delay_ms", 1e3, nominal=3.0),
        "motor_strength": Sweep("motor strength", "motor_strength"),
    }
)


@dataclass(frozen=True)
class Config(Common):
    """What to measure. A sweep without values is left out."""

    speed: float = 1.0
    """Commanded while pushed [m/s]."""
    directions: int = 8
    """Of pushes, all around."""
    phases: int = 8
    """Of the stride at which a push begins; 0 for no pushes at all."""
    repeats: int = 2
    """Trials of each, which differ in sensor noise."""
    bisections: int = 7
    """Halvings of the range of impulses."""
    largest: float = 96.0
    """End of that range [N s]."""
    duration: float = 0.2
    """Of a push, rounded up to policy steps [s]."""
    settle: float = 3.0
    """Walking before a push [s]."""
    after: float = 3.0
    """Walking after a push, without a fall, that counts as surviving it [s]."""
    floor_friction: tuple[float, ...] = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
    """Sliding friction of the floor."""
    payload: tuple[float, ...] = (0.0, 4.0, 8.0, 12.0, 16.0, 20.0)
    """At the pelvis [kg]."""
    slope_deg: tuple[float, ...] = (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0)
    """Of the floor, rising forward."""
    torque_delay_ms: tuple[float, ...] = (0.0, 3.0, 5.0, 7.0, 9.0, 12.0)
    """From command to action."""
    motor_strength: tuple[float, ...] = (0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.4)
    """Delivered over commanded torque."""
    speeds: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
    """Commanded in sweeps [m/s]."""
    episodes: int = 1
    """Walks at each value and speed, which begin at other phases."""
    episode: float = 12.0
    """Length of one [s]."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        least = {"directions": 1, "phases": 0, "repeats": 1, "bisections": 1, "episodes": 1}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise ConfigurationError(f"{name} must be {low} or more, got {getattr(self, name)}")
        for name in ("largest", "duration", "settle", "after", "episode"):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")
