"""Limits of the robot's steps, and weights of what a plan costs."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

import numpy as np

from aslip.base.arrays import Array, namespace
from aslip.base.checks import TINY, check_number
from aslip.errors import ConfigurationError
from aslip.planning.stones import Stones

if TYPE_CHECKING:
    from aslip.planning.program import Problem

Range = tuple[float, float]

# numbers that may be zero
_ZERO: Final = ("margin", "reserve")


@dataclass(frozen=True)
class Limits:
    """Limits of robot and foot; defaults are Cassie's.

    Raises:
        ConfigurationError: a range is not ascending, or a number not positive.
    """

    length: Range = (-0.5, 0.75)
    """Step ahead, from foot to foot [m]."""
    width: Range = (0.1, 0.5)
    """Step outward, from foot to foot [m]; less than 0 would cross the legs."""
    reach: Range = (-0.5, 0.5)
    """Foot ahead of the body at touchdown [m]."""
    outward: Range = (-0.1, 0.4)
    """Foot outward of the body at touchdown [m]."""
    pressure: float = 0.06
    """Centre of pressure ahead of the middle of a foot that stands on a stone, or behind [m]."""
    step_time: Range = (0.25, 0.7)
    """Time between touchdowns [s]."""
    sooner: float = 0.015
    """Time by which a foot in flight lands sooner than by the plan before [s]: one that is suddenly
    due falls short of its foothold."""
    foot_speed: float = 3.0
    """Mean speed of the swing foot from lift-off until it is above its foothold, and from now until
    the touchdown, both relative to the body [m/s]."""
    floor_speed: float = 3.5
    """Speed in the place of `foot_speed` on the floor, where feet may land short of their footholds
    [m/s]."""
    descent: float = 2.0
    """Mean speed at which it comes down [m/s]."""
    rise: float = 0.2
    """Difference in height of successive footholds [m]."""
    clearance: float = 0.12
    """Height of the swing foot above the higher foothold, at half swing [m]."""
    half_foot: float = 0.05
    """Half the length of that part of a foot that shall stand on a stone [m]."""
    margin: float = 0.05
    """Distance that it keeps to the edges of stones [m]."""
    reserve: float = 0.15
    """Share of what is left of a stone, of 0.1 m at most to either side, that each later step does
    not use, either [-]: plans that need all of it fail at the least error."""

    def __post_init__(self) -> None:
        """Check ranges and signs."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(field.default, tuple):
                check_number(field.name, value, 0.0 if field.name in _ZERO else TINY)
            elif np.shape(value) != (2,) or not (np.isfinite(value).all() and value[0] < value[1]):
                raise ConfigurationError(f"{field.name} must be a range (low, high), got {value}")


@dataclass(frozen=True)
class Weights:
    """Weights of squares in the cost.

    Raises:
        ConfigurationError: a weight is negative.
    """

    time: float = 10.0
    """Touchdown sooner or later than nominal [1/s^2]."""
    step: float = 3.0
    """Steps other than the command's [1/m^2]."""
    offset: float = 3.0
    """Offsets of the divergent component other than the command's [1/m^2]."""
    last: float = 100.0
    """The last of these offsets [1/m^2]: most of what comes after depends on it."""
    pressure: float = 3.0
    """Centre of pressure ahead of the middle of the foot, or behind [1/m^2]."""
    stay: float = 1.0
    """A foothold whose stone ends half a step of the command behind where the command would be [-];
    without it, where stones are far apart, a robot would rather step in place than fast."""
    change: float = 10.0
    """Change of the stone that a foot in flight goes to, by its distance beyond an edge [1/m^2]."""
    change_time: float = 60.0
    """Change of the time at which a foot in flight lands [1/s^2]; without it, noise moves the
    touchdown by 0.1 s and more, as the other costs hardly depend on it."""

    def __post_init__(self) -> None:
        """Check that none is negative."""
        for field in fields(self):
            check_number(field.name, getattr(self, field.name), 0.0)

    def stay_of(self, problem: Problem, stones: Stones, foot: float) -> Array:
        """Cost (n, N, m) of stones that are behind the command at each step, see `stay`.

        Args:
            problem: programs of n robots.
            stones: m stones of each.
            foot: distance of a foothold from the edges of a stone [m].
        """
        xp, ahead = namespace(problem.ahead), problem.ahead
        wanted = ((ahead**2).sum(-1, keepdims=True)) ** 0.5
        along = ahead / wanted.clip(TINY)
        start = (problem.stance[:, :2] * along).sum(-1)[:, None]
        ends = (stones.corners * along[:, None, None]).sum(-1)
        most, middle = xp.amax(ends, -1) - foot, (stones.centres * along[:, None]).sum(-1)
        room = xp.maximum(most, middle) - start
        order = xp.arange(problem.side.shape[1], device=problem.side.device) + 0.5
        late = room[:, None] < (order * wanted)[..., None]
        return self.stay * ((late & (wanted > 0)[..., None]) + 0.0 * room[:, None])

    def change_of(self, stones: Stones, aim: Array) -> Array:
        """Cost (n, m) of stones for feet that go to (n, 2 or 3); none where that is NaN."""
        xp = namespace(aim)
        beyond = (stones.normals @ aim[:, None, :2, None])[..., 0] - stones.offsets
        return xp.nan_to_num(self.change * xp.amax(beyond, -1).clip(0.0) ** 2)
