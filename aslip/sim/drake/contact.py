"""Parameters of contact in Drake, importable without Drake."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from aslip.base.checks import TINY, check_number


@dataclass(frozen=True)
class Contact:
    """Contact between robot and floor, by default with Drake's parameters; friction is the MJCF's.

    Raises:
        ConfigurationError: a number is negative or not finite, or the stiffness is zero.
    """

    approximation: Literal["lagged", "similar", "sap"] = "lagged"
    """Convex approximation of contact: dissipation of `lagged` and `similar` is that of Hunt and
    Crossley, dissipation of `sap` is linear."""
    stiffness: float = 5e5
    """Stiffness of a contact point [N/m]; Drake's default of 10^6 N/m for each of the two shapes in
    series gives 5 10^5 N/m."""
    dissipation: float = 50.0
    """Dissipation of Hunt and Crossley [s/m]; only for `lagged` and `similar`."""
    relaxation_time: float = 0.1
    """Ratio of damping to stiffness [s]; only for `sap`."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("stiffness", "dissipation", "relaxation_time"):
            least = TINY if name == "stiffness" else 0.0
            check_number(f"{name} of the contact", getattr(self, name), least)
