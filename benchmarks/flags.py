"""Flags that the benchmarks of a policy share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from aslip.base.assets import UserPaths
from aslip.errors import ConfigurationError


@dataclass(frozen=True)
class Common(UserPaths):
    """Flags of every benchmark of a policy."""

    policy: tuple[str, ...] = ("straight",)
    """Policies to measure: names, files or run folders; several count as seeds of one method."""
    truth: bool = False
    """Give the policy the true state instead of the state estimate."""
    seed: int = 0
    """Seed of the sensor noise."""
    out: Path = Path("runs/benchmarks")
    """Folder for the table, results and picture."""

    def __post_init__(self) -> None:
        """Check that there is a policy."""
        super().__post_init__()
        if not self.policy:
            raise ConfigurationError("name at least one policy")


@dataclass(frozen=True)
class Compared(Common):
    """Flags of benchmarks that compare policies with the paper's settings and its baseline."""

    paper: tuple[str, ...] = ()
    """Policies of `ppo_aslip.py paper`."""
    baseline: tuple[str, ...] = ()
    """Policies of `ppo_aslip.py single-reference`."""

    def __post_init__(self) -> None:
        """Check that there is a policy of any kind."""
        UserPaths.__post_init__(self)  # not that of `Common`, which needs `policy`
        if not (self.policy or self.paper or self.baseline):
            raise ConfigurationError("name at least one policy")


@dataclass(frozen=True)
class WithLibrary(Common):
    """Flags of benchmarks of policies that may walk in all directions."""

    library: str | None = None
    """Library that the policies were trained with; by default that of their stack."""


@dataclass(frozen=True)
class Directions(WithLibrary):
    """Flags of benchmarks of walks in all directions."""

    policy: tuple[str, ...] = ("aslip",)
    """Policies to measure: names, files or run folders; several count as seeds of one method."""
    library: str | None = "directions"
    """Library over three commands that the policies were trained with; a file, or the shipped
    one."""


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
        if self.walks < 1:
            raise ConfigurationError(f"walks must be 1 or more, got {self.walks}")
        if not 0 < self.episode < math.inf:
            raise ConfigurationError(f"episode must be positive, got {self.episode}")
