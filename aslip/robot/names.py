"""Sides of a biped, left before right everywhere, and names of its parts."""

from __future__ import annotations

from typing import Final, Literal

from aslip.errors import UnknownNameError

Side = Literal["left", "right"]

SIDES: Final[tuple[Side, Side]] = ("left", "right")


def mirror_name(name: str) -> str:
    """Name of the same part on the other leg.

    Raises:
        UnknownNameError: the name belongs to neither leg.
    """
    for side, other in (("left", "right"), ("right", "left")):
        if name.startswith(f"{side}_"):
            return name.replace(side, other, 1)
    raise UnknownNameError(f"{name!r} belongs to no leg; names start with 'left_' or 'right_'")
