"""Robots: a frozen `Robot` with names, low level, timing and indices; `CASSIE` is one.

Only `aslip.robot.model` and `aslip.robot.compile` need MuJoCo; import them by their own names.
"""

from typing import Final

from aslip.robot.cassie import CASSIE
from aslip.robot.names import SIDES, Side, mirror_name
from aslip.robot.noise import NoiseLevel
from aslip.robot.robot import Indices, Robot

STANDARD_GRAVITY: Final = 9.81
"""Gravity of robots and reduced-order models [m/s^2] (Table I)."""

__all__ = [
    "CASSIE",
    "SIDES",
    "STANDARD_GRAVITY",
    "Indices",
    "NoiseLevel",
    "Robot",
    "Side",
    "mirror_name",
]
