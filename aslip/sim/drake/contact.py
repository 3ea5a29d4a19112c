"""Compliance and friction of contact in Drake, readable without Drake."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from aslip.errors import ConfigurationError


@dataclass(frozen=True)
class Contact:
    """Contact between the robot and the floor; by default Drake's own, except for friction.

    Raises:
        ConfigurationError: a number is negative, not finite, or a stiffness of zero.
    """

    approximation: Literal["lagged", "similar", "sap"] = "lagged"
    """Convex approximation of contact: `lagged` and `similar` dissipate as Hunt and Crossley,
    `sap` linearly."""
    stiffness: float = 5e5
    """Stiffness of a contact point [N/m]: Drake's default of 10^6 N/m for each of two shapes."""
    dissipation: float = 50.0
    """Dissipation of Hunt and Crossley, `lagged` and `similar` only [s/m]."""
    relaxation_time: float = 0.1
    """Ratio of damping to stiffness, `sap` only [s]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("stiffness", "dissipation", "relaxation_time"):
            value = getattr(self, name)
            if not (np.isfinite(value) and (value > 0 or (value == 0 and name != "stiffness"))):
                raise ConfigurationError(f"{name} of the contact must be positive, got {value!r}")
